"""A frame's points over the planes of the map: the normal equations of a pose that is tried."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapping.alignment.frame_points import FramePoints
from mapping.alignment.plane_kernels import PLANE_COLUMNS, WindowPlace, fit_planes
from mapping.alignment.residual_kernels import Guess, Weighting, normal_equations
from mapping.alignment.settings import AlignmentSettings
from mapping.cells.grid import CellWindow, Grid

Float64Array = NDArray[np.float64]

# Median of |x| of a standard normal variable, inverted.
_MEDIAN_TO_SIGMA = 1.0 / 0.6744897501960817
# No plane is known better than this: it keeps weights finite.
_PLANE_FLOOR_M2 = 0.0005**2


@dataclass(frozen=True, slots=True)
class NormalEquations:
    """One linearisation over (shift, rotation about T's axes), metres and radians.

    Attributes:
        normal: (6, 6) J' w J.
        noise: (6, 6) what noise of the planes' slopes adds to it.
        gradient: (6,) J' w r.
        points: points that met a plane.
        sigma_scale: spread of their residuals over the claimed sigma, from the median.
    """

    normal: Float64Array
    noise: Float64Array
    gradient: Float64Array
    points: int
    sigma_scale: float


class PlaneProblem:
    """Keeps the planes and work arrays from frame to frame."""

    def __init__(self, settings: AlignmentSettings, cell_size_m: float) -> None:
        self._settings = settings
        self._cell_size_m = cell_size_m
        self._planes = np.zeros((0, PLANE_COLUMNS))
        self._residuals = np.zeros(0)
        self._sums = np.zeros((13, 6))
        self._window = CellWindow(0, 0, 0, 0)

    def take(self, grid: Grid, window: CellWindow) -> None:
        """Fit planes to the cells of a window; it must lie in the grid."""
        cells = window.cells_x * window.cells_y
        if self._planes.shape[0] < cells:
            self._planes = np.zeros((cells, PLANE_COLUMNS))
            self._residuals = np.zeros(cells)
        row, column = grid.position(window)
        place = WindowPlace(row, column, window.cells_x, window.cells_y, self._cell_size_m)
        layers = grid.layers
        fewest = self._settings.fewest_pixels
        fit_planes(layers.elevation_m, layers.frames, layers.pixels, place, fewest, self._planes)
        self._window = window

    def linearise(
        self,
        points: FramePoints,
        shift_m: Float64Array,
        rotation: Float64Array,
        robust_scale: float,
    ) -> NormalEquations:
        """Return the normal equations at a pose.

        Args:
            points: of the frame, over the window that was taken.
            shift_m, rotation: (3,), (3, 3), of the pose relative to the one that `points` are at.
            robust_scale: residuals of so many sigma weigh half.
        """
        lever = rotation @ points.lever_m
        numbers = (*rotation.ravel(), *shift_m, *lever, *points.corner_m, points.base_z_m)
        size = (self._cell_size_m, self._window.cells_x, self._window.cells_y)
        guess = Guess._make([*map(float, numbers), *size])
        weighting = Weighting(self._settings.cut_m, robust_scale, _PLANE_FLOOR_M2)
        sums = self._sums
        met = normal_equations(
            points.values, points.axial_m2, self._planes, guess, weighting, sums, self._residuals
        )
        spread = _MEDIAN_TO_SIGMA * float(np.median(self._residuals[:met])) if met else 0.0
        return NormalEquations(
            _symmetric(sums[:6]), _symmetric(sums[6:12]), sums[12].copy(), met, spread
        )


def _symmetric(lower: Float64Array) -> Float64Array:
    """Return the full matrix of a lower triangle."""
    full: Float64Array = np.tril(lower) + np.tril(lower, -1).T
    return full
