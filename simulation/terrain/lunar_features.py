"""Craters and rocks of a lunar plain: how many of which size, and their shape in a height grid."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulation.terrain.ground_layout import Extent

Float64Array = NDArray[np.float64]

# Depth and rim height over diameter, from worn to fresh (fresh: Pike 1977; worn: surveys of
# metre-sized craters at the landing sites).
WORN_DEPTH, FRESH_DEPTH = 0.06, 0.25
WORN_RIM, FRESH_RIM = 0.022, 0.06
# Craters fresher than f (0 worn, 1 fresh) are 100^-f of all: 0.002 D^-2 where all are 0.2 D^-2.
_FRESH_SHARE = 0.01
# A rim falls off with the third power of the distance and ends here, in crater radii.
_RIM_END = 2.5


def crater_count(diameter_m: float, density: float) -> float:
    """Return N(>D) per m^2 = c D^-2, the steady state of small craters.

    Moore, Boyce and Hahn 1980; geometric saturation is c = 1.54 (Gault 1970), and surfaces in
    equilibrium have some percent of it.
    """
    return density / diameter_m**2


def sample_craters(
    extent: Extent, density: float, diameters_m: tuple[float, float], random: np.random.Generator
) -> Float64Array:
    """Return (N, 4) craters: x, y, diameter in metres, freshness from 0 to 1; largest first.

    None where the least diameter is not below the largest.
    """
    smallest, largest = diameters_m
    if smallest >= largest:
        return np.empty((0, 4))
    number_of_largest = crater_count(largest, density)
    number = crater_count(smallest, density) - number_of_largest
    total = random.poisson(number * _area_m2(extent))
    rank = number_of_largest + number * random.random(total)
    diameter = np.sort(np.sqrt(density / rank))[::-1]
    freshness = np.log(random.uniform(_FRESH_SHARE, 1.0, total)) / np.log(_FRESH_SHARE)
    return np.column_stack([_places(extent, total, random), diameter, freshness])


def rock_decay(share: float) -> float:
    """Return q(k) = 1.79 + 0.152 / k of Golombek and Rapp 1997, per metre."""
    return 1.79 + 0.152 / share


def rock_cover(diameter_m: float, share: float) -> float:
    """Return the share of the ground under rocks of diameter > D: F = k exp(-q D)."""
    return float(share * np.exp(-rock_decay(share) * diameter_m))


def rock_count(diameter_m: float, share: float) -> float:
    """Return N(>D) of rocks per m^2: what covers F when each covers pi D^2 / 4."""
    sizes = np.geomspace(diameter_m, 20.0, 4001)
    return float(_rocks_above(sizes, share)[0])


def sample_rocks(
    extent: Extent, share: float, diameters_m: tuple[float, float], random: np.random.Generator
) -> Float64Array:
    """Return (N, 6) rocks: x, y, diameter, height in metres, width over length, heading in rad.

    None where the least diameter is not below the largest.
    """
    if diameters_m[0] >= diameters_m[1]:
        return np.empty((0, 6))
    sizes = np.geomspace(*diameters_m, 513)
    above = _rocks_above(sizes, share)
    total = random.poisson(above[0] * _area_m2(extent))
    diameter = np.interp(random.random(total) * above[0], above[::-1], sizes[::-1])
    shape = [
        diameter * random.uniform(0.3, 0.6, total),
        random.uniform(0.6, 1.0, total),
        random.uniform(0.0, np.pi, total),
    ]
    return np.column_stack([_places(extent, total, random), diameter, *shape])


def _rocks_above(sizes: Float64Array, share: float) -> Float64Array:
    """Return N(>D) - N(> last size) per m^2 for increasing sizes."""
    decay = rock_decay(share)
    density = 4.0 * share * decay * np.exp(-decay * sizes) / (np.pi * sizes**2)
    steps = 0.5 * (density[1:] + density[:-1]) * np.diff(sizes)
    return np.append(np.cumsum(steps[::-1])[::-1], 0.0)


def _area_m2(extent: Extent) -> float:
    x_min, x_max, y_min, y_max = extent
    return (x_max - x_min) * (y_max - y_min)


def _places(extent: Extent, number: int, random: np.random.Generator) -> Float64Array:
    x_min, x_max, y_min, y_max = extent
    return np.column_stack(
        [random.uniform(x_min, x_max, number), random.uniform(y_min, y_max, number)]
    )


@njit(cache=True, error_model="numpy")
def _span(centre: float, reach: float, nodes: int) -> tuple[int, int]:
    """Return the first node and the one after the last within reach, all in squares."""
    first = max(int(np.ceil(centre - reach)), 0)
    return first, min(int(np.floor(centre + reach)) + 1, nodes)


@njit(cache=True, error_model="numpy")
def add_craters(
    height_m: Float64Array,
    origin_m: tuple[float, float],
    spacing_m: float,
    craters: Float64Array,
) -> None:
    """Dig craters into heights, in place: a parabolic bowl and a rim that falls off as r^-3."""
    rows, columns = height_m.shape
    far = _RIM_END**-3
    for i in range(craters.shape[0]):
        x, y, diameter, freshness = craters[i]
        radius = 0.5 * diameter / spacing_m
        depth = diameter * (WORN_DEPTH + freshness * (FRESH_DEPTH - WORN_DEPTH))
        rim = diameter * (WORN_RIM + freshness * (FRESH_RIM - WORN_RIM))
        x = (x - origin_m[0]) / spacing_m
        y = (y - origin_m[1]) / spacing_m
        r_first, r_end = _span(y, _RIM_END * radius, rows)
        c_first, c_end = _span(x, _RIM_END * radius, columns)
        for r in range(r_first, r_end):
            for c in range(c_first, c_end):
                distance = np.hypot(r - y, c - x) / radius
                if distance < 1.0:
                    height_m[r, c] += rim - depth * (1.0 - distance * distance)
                elif distance < _RIM_END:
                    height_m[r, c] += rim * (distance**-3 - far) / (1.0 - far)


@njit(cache=True, error_model="numpy")
def add_rocks(
    height_m: Float64Array,
    origin_m: tuple[float, float],
    spacing_m: float,
    rocks: Float64Array,
) -> None:
    """Put half-ellipsoids on the ground, in place; each stands on the height at its centre."""
    rows, columns = height_m.shape
    for i in range(rocks.shape[0]):
        x, y, diameter, tall, aspect, heading = rocks[i]
        # Length and width whose ellipse has the area of a disc of that diameter.
        length = 0.5 * diameter / spacing_m / np.sqrt(aspect)
        cos, sin = np.cos(heading), np.sin(heading)
        x = (x - origin_m[0]) / spacing_m
        y = (y - origin_m[1]) / spacing_m
        foot = height_m[min(max(int(y + 0.5), 0), rows - 1), min(max(int(x + 0.5), 0), columns - 1)]
        r_first, r_end = _span(y, length, rows)
        c_first, c_end = _span(x, length, columns)
        for r in range(r_first, r_end):
            for c in range(c_first, c_end):
                along = (cos * (c - x) + sin * (r - y)) / length
                across = (cos * (r - y) - sin * (c - x)) / (length * aspect)
                inside = 1.0 - along * along - across * across
                if inside > 0.0:
                    height_m[r, c] = max(height_m[r, c], foot + tall * np.sqrt(inside))
