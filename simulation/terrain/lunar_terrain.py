"""Seeded lunar ground: self-affine relief, craters, rocks, and a flat place to start from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulation.errors import SimulationError
from simulation.terrain.ground_layout import FLAT_START, Extent, FlatStart, grid_shape, level_start
from simulation.terrain.height_grid import HeightGrid
from simulation.terrain.lunar_features import (
    add_craters,
    add_rocks,
    sample_craters,
    sample_rocks,
)
from simulation.terrain.rough_ground import rough_ground

Float64Array = NDArray[np.float64]

DEFAULT_EXTENT: Extent = (-4.0, 16.0, -10.0, 10.0)
LARGEST_CRATER_M = 4.0


@dataclass(frozen=True, slots=True)
class LunarPreset:
    """How rough a lunar plain is.

    Attributes:
        ground_slope_deg: median slope of the ground between craters and rocks, 2 cm baseline.
        crater_density: c in N(>D) = c D^-2 per m^2.
        rock_share: k in F = k exp(-q D).
        largest_rock_m: larger ones are not placed.
        slope_2cm_deg, slope_1m_deg: median slopes of the whole, which the above add up to.
    """

    ground_slope_deg: float
    crater_density: float
    rock_share: float
    largest_rock_m: float
    slope_2cm_deg: float
    slope_1m_deg: float


PRESETS = {
    "smooth": LunarPreset(3.5, 0.01, 0.005, 0.15, 3.6, 1.7),
    "nominal": LunarPreset(5.6, 0.02, 0.02, 0.3, 6.1, 2.7),
    "rough": LunarPreset(7.6, 0.05, 0.05, 0.5, 9.3, 4.3),
}


@dataclass(frozen=True, slots=True)
class LunarTerrain:
    """A ground and what was put on it.

    Attributes:
        grid: the heights.
        craters: (N, 4) x, y, diameter in metres, freshness 0 to 1; those at the level start were
            filled in.
        rocks: (N, 6) x, y, diameter, height in metres, width over length, heading in radians.
    """

    grid: HeightGrid
    craters: Float64Array
    rocks: Float64Array


def lunar_terrain(
    preset: str,
    seed: int,
    *,
    extent: Extent = DEFAULT_EXTENT,
    spacing_m: float = 0.02,
    start: FlatStart = FLAT_START,
) -> LunarTerrain:
    """Return a lunar plain; same arguments, same ground.

    Args:
        preset: a name in `PRESETS`.
        seed: 0 or more.
        extent: x_min, x_max, y_min, y_max in metres.
        spacing_m: distance of the nodes; no crater or rock is smaller than 4 of it.
        start: where the rover stands at first.

    Raises:
        SimulationError: no such preset, a negative seed, or an extent that cannot be gridded.
    """
    if preset not in PRESETS:
        raise SimulationError(f"no lunar terrain {preset!r}; expected one of {', '.join(PRESETS)}")
    if seed < 0:
        raise SimulationError(f"seed {seed}; expected 0 or more")
    kind = PRESETS[preset]
    shape = grid_shape(extent, spacing_m)
    of_ground, of_craters, of_rocks = (np.random.default_rng([seed, part]) for part in range(3))
    heights = rough_ground(shape, spacing_m, np.radians(kind.ground_slope_deg), of_ground)
    smallest_m = smallest_feature_m(spacing_m)
    origin = (extent[0], extent[2])
    sizes = (smallest_m, LARGEST_CRATER_M)
    craters = sample_craters(extent, kind.crater_density, sizes, of_craters)
    add_craters(heights, origin, spacing_m, craters)
    level_start(heights, extent, spacing_m, start)
    rocks = sample_rocks(extent, kind.rock_share, (smallest_m, kind.largest_rock_m), of_rocks)
    away = np.hypot(rocks[:, 0] - start.x_m, rocks[:, 1] - start.y_m)
    rocks = rocks[away > start.radius_m + rocks[:, 2]]
    add_rocks(heights, origin, spacing_m, rocks)
    return LunarTerrain(HeightGrid(*origin, spacing_m, heights.astype(np.float32)), craters, rocks)


def smallest_feature_m(spacing_m: float) -> float:
    """Return the diameter of the smallest craters and rocks: below 4 squares they are spikes."""
    return 4.0 * spacing_m
