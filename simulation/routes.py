"""Ways that a driver with eyes would take: around the rocks, there and back."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simulation import jackal

Float64Array = NDArray[np.float64]
Point = tuple[float, float]

# Lower rocks pass under the chassis' belly, or a wheel climbs them.
_LOW_ROCK_M = 0.05
_OFFSETS_M = np.linspace(-1.5, 1.5, 31)
_CLEARANCE_M = jackal.TRACK_M / 2.0 + jackal.WHEEL_WIDTH_M / 2.0 + 0.15
_HIT_COST = 100.0


def circle(radius_m: float, step_m: float) -> tuple[Float64Array, Float64Array]:
    """Return (N, 2) points of a circle to the left from the origin along x, and outward normals."""
    number = math.ceil(2.0 * math.pi * radius_m / step_m)
    angle = 2.0 * np.pi * np.arange(1, number + 1) / number
    outward = np.column_stack([np.sin(angle), -np.cos(angle)])
    return radius_m * outward + [0.0, radius_m], outward


def there_and_back(length_m: float, way_m: float) -> list[Point]:
    """Return ends of the stretch from the origin along x, as often as the way needs."""
    turns = math.ceil(way_m / length_m) + 1
    return [(length_m if i % 2 == 0 else 0.0, 0.0) for i in range(turns)]


def around_rocks(points_m: Float64Array, normals: Float64Array, rocks: Float64Array) -> list[Point]:
    """Return points moved along their normals so that the way misses the rocks if it can.

    The cheapest way through the offsets of all points, by dynamic programming. The cost is the
    square of the offset (m), ten times the square of its change, and 100 for every rock hit.

    Args:
        points_m: (N, 2), nearer to each other than a rock's diameter plus the vehicle's width.
        normals: (N, 2) unit vectors.
        rocks: (M, 6) as in `simulation.lunar_terrain.LunarTerrain`.
    """
    places = points_m[:, np.newaxis] + _OFFSETS_M[:, np.newaxis] * normals[:, np.newaxis]
    standing = _OFFSETS_M**2 + _HIT_COST * _rocks_hit(places, rocks[rocks[:, 3] > _LOW_ROCK_M])
    changing = 10.0 * (_OFFSETS_M[:, np.newaxis] - _OFFSETS_M) ** 2
    total = standing[0] + 10.0 * _OFFSETS_M**2  # the way begins at offset 0
    came_from: list[NDArray[np.intp]] = []
    for cost in standing[1:]:
        by_last = total[:, np.newaxis] + changing
        came_from.append(by_last.argmin(axis=0))
        total = by_last.min(axis=0) + cost
    chosen = [int(total.argmin())]
    for last in reversed(came_from):
        chosen.append(int(last[chosen[-1]]))
    moved = places[np.arange(len(places)), chosen[::-1]]
    return [(float(x), float(y)) for x, y in moved]


def _rocks_hit(places_m: Float64Array, rocks: Float64Array) -> Float64Array:
    """Return how many rocks are too near to each of (N, K, 2) places."""
    hit = np.zeros(places_m.shape[:2])
    for x, y, diameter, *_ in rocks:
        away = np.hypot(places_m[..., 0] - x, places_m[..., 1] - y)
        hit += away < diameter / 2.0 + _CLEARANCE_M
    return hit
