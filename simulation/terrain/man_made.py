"""Grounds on Earth: a hall with boxes and a carpet, and a field with weeds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulation.errors import SimulationError
from simulation.terrain.ground_layout import FLAT_START, Extent, grid_shape, level_start
from simulation.terrain.height_grid import HeightGrid
from simulation.terrain.rough_ground import rough_ground

Float64Array = NDArray[np.float64]

HALL_EXTENT: Extent = (-3.0, 11.0, -4.0, 4.0)
FIELD_EXTENT: Extent = (-4.0, 16.0, -8.0, 8.0)
# Nothing solid stands nearer to the x axis, along which a drive leads.
CLEAR_HALF_WIDTH_M = 0.6

_BOXES = 14
_CARPET: Extent = (2.0, 5.0, -1.2, 1.2)
_CARPET_THICKNESS_M = 0.008
_FIELD_SLOPE_RAD = float(np.radians(5.0))
_CLUMPS_PER_M2 = 0.35
_BLADES = 25
_BLADE_RADIUS_M = 0.015


def indoor_hall(seed: int, *, extent: Extent = HALL_EXTENT, spacing_m: float = 0.02) -> HeightGrid:
    """Return a flat floor with boxes of 10-45 cm and a carpet that lies in folds up to 5 cm.

    The carpet lies across the x axis from 2 to 5 m; the boxes leave the axis clear.

    Raises:
        SimulationError: a negative seed, or an extent that cannot be gridded.
    """
    random = _generator(seed)
    heights = np.zeros(grid_shape(extent, spacing_m))
    x, y = _axes(heights, extent, spacing_m)
    _lay_carpet(heights, x, y, random)
    for _ in range(_BOXES):
        half = random.uniform(0.1, 0.35, 2)
        tall, heading = random.uniform(0.1, 0.45), random.uniform(0.0, np.pi)
        centre_x = random.uniform(extent[0], extent[1])
        nearest = CLEAR_HALF_WIDTH_M + float(np.hypot(*half))
        centre_y = random.choice([-1.0, 1.0]) * random.uniform(nearest, nearest + 2.0)
        along = np.cos(heading) * (x - centre_x) + np.sin(heading) * (y - centre_y)
        across = np.cos(heading) * (y - centre_y) - np.sin(heading) * (x - centre_x)
        heights[(np.abs(along) <= half[0]) & (np.abs(across) <= half[1])] = tall
    return HeightGrid(extent[0], extent[2], spacing_m, heights.astype(np.float32))


def outdoor_field(
    seed: int, *, extent: Extent = FIELD_EXTENT, spacing_m: float = 0.02
) -> HeightGrid:
    """Return bare soil with clumps of weeds, 5-25 cm tall, beside the x axis; level at the start.

    The weeds are part of the ground: thin cones, as stiff as the soil.

    Raises:
        SimulationError: a negative seed, or an extent that cannot be gridded.
    """
    random = _generator(seed)
    heights = rough_ground(grid_shape(extent, spacing_m), spacing_m, _FIELD_SLOPE_RAD, random)
    level_start(heights, extent, spacing_m, FLAT_START)
    area_m2 = (extent[1] - extent[0]) * (extent[3] - extent[2])
    for _ in range(random.poisson(_CLUMPS_PER_M2 * area_m2)):
        x, y = random.uniform(extent[0], extent[1]), random.uniform(extent[2], extent[3])
        blades = np.array([x, y]) + random.normal(0.0, 0.08, (_BLADES, 2))
        tall = random.uniform(0.05, 0.25) * random.uniform(0.3, 1.0, _BLADES)
        beside = np.abs(blades[:, 1]) > CLEAR_HALF_WIDTH_M
        for blade, height_m in zip(blades[beside], tall[beside], strict=True):
            _add_blade(heights, (blade - [extent[0], extent[2]]) / spacing_m, height_m, spacing_m)
    return HeightGrid(extent[0], extent[2], spacing_m, heights.astype(np.float32))


def _generator(seed: int) -> np.random.Generator:
    if seed < 0:
        raise SimulationError(f"seed {seed}; expected 0 or more")
    return np.random.default_rng(seed)


def _axes(
    heights: Float64Array, extent: Extent, spacing_m: float
) -> tuple[Float64Array, Float64Array]:
    """Return x as a row and y as a column."""
    rows, columns = heights.shape
    x = extent[0] + spacing_m * np.arange(columns, dtype=np.float64)
    y = extent[2] + spacing_m * np.arange(rows, dtype=np.float64)
    return x[np.newaxis, :], y[:, np.newaxis]


def _lay_carpet(
    heights: Float64Array, x: Float64Array, y: Float64Array, random: np.random.Generator
) -> None:
    """Lay the carpet onto the floor: waves 0.4-1 m long that vanish at its edges."""
    x_min, x_max, y_min, y_max = _CARPET
    edge = np.minimum(np.minimum(x - x_min, x_max - x), np.minimum(y - y_min, y_max - y))
    waves = np.zeros_like(heights)
    for _ in range(4):
        k, heading = 2.0 * np.pi / random.uniform(0.4, 1.0), random.uniform(-0.6, 0.6)
        along = np.cos(heading) * x + np.sin(heading) * y
        waves += 0.01 * (0.5 + 0.5 * np.sin(k * along + random.uniform(0.0, 2.0 * np.pi)))
    folds = waves * np.clip(edge / 0.3, 0.0, 1.0)
    heights += np.where(edge >= 0.0, _CARPET_THICKNESS_M + folds, 0.0)


def _add_blade(
    heights: Float64Array, place: Float64Array, height_m: float, spacing_m: float
) -> None:
    """Put a thin cone at a place in squares, in place; beyond the edge there is none."""
    reach = max(_BLADE_RADIUS_M / spacing_m, 1.0)
    column, row = place
    rows = np.arange(max(int(row - reach), 0), min(int(row + reach) + 2, heights.shape[0]))
    columns = np.arange(max(int(column - reach), 0), min(int(column + reach) + 2, heights.shape[1]))
    away = np.hypot(rows[:, np.newaxis] - row, columns - column) / reach
    if away.size:
        patch = heights[np.ix_(rows, columns)]
        cone = patch.min() + height_m * (1.0 - away)
        heights[np.ix_(rows, columns)] = np.maximum(patch, cone)
