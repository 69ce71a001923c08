"""How rough a ground is: the measures in which lunar roughness is published."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulation.errors import SimulationError
from simulation.terrain.height_grid import HeightGrid

Float64Array = NDArray[np.float64]

SLOPE_BASELINES_M = (0.02, 0.04, 0.1, 0.2, 0.4, 1.0, 2.0)
WINDOWS_M = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)


@dataclass(frozen=True, slots=True)
class TerrainStatistics:
    """Roughness by scale; the keys are baselines and window edges in metres.

    Attributes:
        median_slope_rad: median slope of the gradient over a baseline.
        deviation_m: RMS height difference between points a baseline apart, along x and y.
        rms_height_m: RMS over square windows of the height above each window's mean plane.
    """

    median_slope_rad: dict[float, float]
    deviation_m: dict[float, float]
    rms_height_m: dict[float, float]

    def exponent(self, short_m: float, long_m: float) -> float:
        """Return the Hurst exponent between two baselines: the slope of log deviation."""
        rise = np.log(self.deviation_m[long_m] / self.deviation_m[short_m])
        return float(rise / np.log(long_m / short_m))


def terrain_statistics(
    grid: HeightGrid,
    baselines_m: Sequence[float] = SLOPE_BASELINES_M,
    windows_m: Sequence[float] = WINDOWS_M,
) -> TerrainStatistics:
    """Return the roughness of a ground.

    Baselines below the spacing, windows below three nodes, and what is larger than the ground
    are left out.
    """
    heights = grid.height_m.astype(np.float64)
    shorter = min(heights.shape) - 1
    slopes: dict[float, float] = {}
    deviations: dict[float, float] = {}
    for baseline in baselines_m:
        squares = round(baseline / grid.spacing_m)
        if 1 <= squares <= shorter:
            slopes[baseline], deviations[baseline] = _slope_and_deviation(
                heights, squares, squares * grid.spacing_m
            )
    windows = {window: round(window / grid.spacing_m) for window in windows_m}
    rms = {
        window: _rms_height(heights, nodes)
        for window, nodes in windows.items()
        if 3 <= nodes <= shorter
    }
    return TerrainStatistics(slopes, deviations, rms)


def count_per_m2(
    diameters_m: Float64Array, above_m: Sequence[float], area_m2: float
) -> dict[float, float]:
    """Return N(>D) per m^2 of craters or rocks for each diameter D.

    Raises:
        SimulationError: the area is not positive.
    """
    if not area_m2 > 0.0:
        raise SimulationError(f"an area of {area_m2} m^2; expected more than 0")
    return {d: np.count_nonzero(diameters_m > d) / area_m2 for d in above_m}


def _slope_and_deviation(
    heights: Float64Array, squares: int, baseline_m: float
) -> tuple[float, float]:
    """Return the median slope in radians and the RMS difference in metres over a baseline."""
    along_x = heights[:-squares, squares:] - heights[:-squares, :-squares]
    along_y = heights[squares:, :-squares] - heights[:-squares, :-squares]
    slope = np.arctan(float(np.median(np.hypot(along_x, along_y))) / baseline_m)
    deviation = np.sqrt(0.5 * (np.mean(along_x**2) + np.mean(along_y**2)))
    return float(slope), float(deviation)


def _rms_height(heights: Float64Array, nodes: int) -> float:
    """Return the RMS height above the mean plane of windows of that many nodes a side."""
    rows, columns = (size // nodes for size in heights.shape)
    windows = heights[: rows * nodes, : columns * nodes]
    windows = windows.reshape(rows, nodes, columns, nodes)
    offset = np.arange(nodes) - 0.5 * (nodes - 1)
    spread = np.mean(offset**2)
    variance = windows.var(axis=(1, 3))
    along_x = np.mean(windows.mean(axis=1) * offset, axis=2) ** 2 / spread
    along_y = np.mean(windows.mean(axis=3) * offset[:, np.newaxis], axis=1) ** 2 / spread
    return float(np.sqrt(np.mean(variance - along_x - along_y)))
