"""A depth frame as few points: the mean of the readings over each cell of the map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapping.alignment.point_kernels import (
    POINT_COLUMNS,
    POINT_DEPTH,
    POINT_PIXELS,
    PointGeometry,
    group_points,
)
from mapping.cells.grid import CellWindow
from mapping.measurement import SENSOR_WIDTH_PX, FrameReducer, View
from mapping.noise import DepthNoiseModel, independent_readings

Float64Array = NDArray[np.float64]

# Every reading of an image this wide is used, every second one of an image twice as wide.
_WIDTH_PX = 320


@dataclass(frozen=True, slots=True)
class FramePoints:
    """Points of a frame, relative to the tracked body of a first guess, in T's axes.

    Attributes:
        values: (N, POINT_COLUMNS).
        axial_m2: (N,) variance of the mean along the optical axis.
        lever_m: (3,) camera relative to the tracked body.
        corner_m: (2,) corner of the window of cells relative to the tracked body.
        base_z_m: height of the tracked body in T.
    """

    values: Float64Array
    axial_m2: Float64Array
    lever_m: Float64Array
    corner_m: Float64Array
    base_z_m: float


class PointGrouper:
    """Averages readings over cells; keeps its work arrays from frame to frame."""

    def __init__(self, cell_size_m: float, fewest_pixels: int) -> None:
        self._cell_size_m = cell_size_m
        self._fewest_pixels = fewest_pixels
        self._sums = np.zeros((0, POINT_COLUMNS))
        self._points = np.zeros((0, POINT_COLUMNS))

    def group(self, reducer: FrameReducer, view: View, window: CellWindow) -> FramePoints:
        """Return the points of the loaded frame over a window; valid until the next call."""
        cells = window.cells_x * window.cells_y
        if self._sums.shape[0] < cells:
            self._sums = np.zeros((cells, POINT_COLUMNS))
            self._points = np.zeros((cells, POINT_COLUMNS))
        body = view.body.transform.translation_m
        lever = view.T_terrain_sensor.translation_m - body
        corner = np.array([window.first_x, window.first_y]) * self._cell_size_m - body[:2]
        numbers = map(float, (*view.T_terrain_sensor.rotation.ravel(), *lever, *corner))
        size = (self._cell_size_m, window.cells_x, window.cells_y)
        geometry = PointGeometry._make([*numbers, *size])
        loaded = reducer.readings
        stride = max(1, round(reducer.camera.width_px / _WIDTH_PX))
        count = group_points(
            loaded.z_m,
            loaded.margin_px,
            stride,
            loaded.ray_x,
            loaded.ray_y,
            geometry,
            self._fewest_pixels,
            self._sums,
            self._points,
        )
        values = self._points[:count]
        decimation = SENSOR_WIDTH_PX / reducer.camera.width_px * stride
        axial_m2 = _axial_variance(values, reducer.noise, decimation)
        return FramePoints(values, axial_m2, lever, corner, float(body[2]))


def _axial_variance(
    points: Float64Array, noise: DepthNoiseModel, decimation: float
) -> Float64Array:
    """Return (N,) variance of each point's mean distance; the incidence enters elsewhere."""
    z_m = points[:, POINT_DEPTH]
    single = noise.axial_sigma_m(z_m, np.zeros(1)) ** 2
    alike = max(noise.correlation_area_px / decimation**2, 1.0)
    return single / independent_readings(points[:, POINT_PIXELS], alike)
