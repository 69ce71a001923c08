"""Ways that a driver with eyes would take: around the rocks, there and back."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from simulation.vehicle import jackal

Float64Array = NDArray[np.float64]
Point = tuple[float, float]

# A wheel climbs lower rocks, even in a turn.
_LOW_ROCK_M = 0.03
_OFFSETS_M = np.linspace(-1.5, 1.5, 31)
_CLEARANCE_M = jackal.TRACK_M / 2.0 + jackal.WHEEL_WIDTH_M / 2.0 + 0.15
_NEAR_M = 3.0  # farther rocks do not reach any of the offsets
_TURN_COST = 10.0
_ROCK_COST = 1e4  # for the square of its height, m^2


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

    The cheapest way through the offsets of all points, by dynamic programming; it begins at the
    first point's offset 0. The cost is the square of the offset (m), ten times the square of its
    change, and 100 for a rock of 10 cm that the way comes too near to, by the square of height.

    Args:
        points_m: (N, 2) way that is wanted.
        normals: (N, 2) unit vectors.
        rocks: (M, 6) as in `simulation.terrain.lunar_terrain.LunarTerrain`.
    """
    high = rocks[rocks[:, 3] > _LOW_ROCK_M]
    places = points_m[:, np.newaxis] + _OFFSETS_M[:, np.newaxis] * normals[:, np.newaxis]
    turning = _TURN_COST * (_OFFSETS_M[:, np.newaxis] - _OFFSETS_M) ** 2
    total = np.where(_OFFSETS_M == 0.0, 0.0, np.inf)
    came_from = []
    for begin, end in pairwise(places):
        by_last = total[:, np.newaxis] + turning + _rock_costs(begin, end, high)
        came_from.append(by_last.argmin(axis=0))
        total = by_last.min(axis=0) + _OFFSETS_M**2
    chosen = [int(total.argmin())]
    for last in reversed(came_from):
        chosen.append(int(last[chosen[-1]]))
    moved = places[np.arange(len(places)), chosen[::-1]]
    return [(float(x), float(y)) for x, y in moved]


def _rock_costs(begin_m: Float64Array, end_m: Float64Array, rocks: Float64Array) -> Float64Array:
    """Return (K, K) costs of the straight ways from each of (K, 2) places to each of the next."""
    costs = np.zeros((len(begin_m), len(end_m)))
    middle = (begin_m + end_m).mean(axis=0) / 2.0
    near = np.linalg.norm(rocks[:, :2] - middle, axis=1) < _NEAR_M
    way = end_m - begin_m[:, np.newaxis]
    length2 = (way**2).sum(axis=-1)
    for x, y, diameter, height_m, *_ in rocks[near]:
        to_rock = [x, y] - begin_m[:, np.newaxis]
        share = np.clip((to_rock * way).sum(axis=-1) / length2, 0.0, 1.0)
        away = np.linalg.norm(to_rock - share[..., np.newaxis] * way, axis=-1)
        costs += _ROCK_COST * height_m**2 * (away < diameter / 2.0 + _CLEARANCE_M)
    return costs
