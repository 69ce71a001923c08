"""Readings of a depth frame to one mean point per cell (numba, cached, fixed order of sums)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]

# Columns of a frame's points: mean position relative to the tracked body in T's axes, mean
# distance along the optical axis, readings.
POINT_X, POINT_Y, POINT_Z, POINT_DEPTH, POINT_PIXELS = range(5)
POINT_COLUMNS = 5


class PointGeometry(NamedTuple):
    """Where the camera is and which cells are looked at.

    rXY: elements of C_TS. lever_*: camera relative to the tracked body, in T. corner_*: corner of
    the window of cells relative to the tracked body.
    """

    r00: float
    r01: float
    r02: float
    r10: float
    r11: float
    r12: float
    r20: float
    r21: float
    r22: float
    lever_x_m: float
    lever_y_m: float
    lever_z_m: float
    corner_x_m: float
    corner_y_m: float
    cell_size_m: float
    cells_x: int
    cells_y: int


@njit(cache=True, error_model="numpy")
def group_points(
    z_m: Float32Array,
    margin: int,
    stride: int,
    ray_x: Float32Array,
    ray_y: Float32Array,
    g: PointGeometry,
    fewest_pixels: int,
    sums: Float64Array,
    points: Float64Array,
) -> int:
    """Average a frame's readings per cell of the window; return how many points came out.

    Args:
        z_m: (height + 2 margin, width + 2 margin) distances, 0 = no reading.
        margin: rows and columns of zeros around them.
        stride: every so many rows and columns are used.
        ray_x, ray_y: x/z of every column and y/z of every row.
        g: the view.
        fewest_pixels: cells with fewer readings make no point.
        sums: (cells, POINT_COLUMNS) of 0, which it is again afterwards.
        points: (cells, POINT_COLUMNS), filled from the front in the order of the cells.
    """
    for v in range(0, ray_y.shape[0], stride):
        row = z_m[v + margin]
        for u in range(0, ray_x.shape[0], stride):
            if row[u + margin] > 0.0:
                _add(row[u + margin], ray_x[u], ray_y[v], g, sums)
    found = 0
    for k in range(g.cells_x * g.cells_y):
        pixels = sums[k, POINT_PIXELS]
        if pixels >= fewest_pixels:
            points[found] = sums[k] / pixels
            points[found, POINT_PIXELS] = pixels
            found += 1
        if pixels > 0.0:
            sums[k] = 0.0
    return found


@njit(inline="always")
def _add(
    z_m: np.float32, ray_x: np.float32, ray_y: np.float32, g: PointGeometry, sums: Float64Array
) -> None:
    """Add the reading z (x, y, 1) to the sums of the cell under it."""
    z, x, y = np.float64(z_m), np.float64(ray_x), np.float64(ray_y)
    px = g.lever_x_m + z * (g.r00 * x + g.r01 * y + g.r02)
    py = g.lever_y_m + z * (g.r10 * x + g.r11 * y + g.r12)
    column = np.floor((px - g.corner_x_m) / g.cell_size_m)
    row = np.floor((py - g.corner_y_m) / g.cell_size_m)
    if 0.0 <= column < g.cells_x and 0.0 <= row < g.cells_y:
        k = np.int64(row) * g.cells_x + np.int64(column)
        sums[k, POINT_X] += px
        sums[k, POINT_Y] += py
        sums[k, POINT_Z] += g.lever_z_m + z * (g.r20 * x + g.r21 * y + g.r22)
        sums[k, POINT_DEPTH] += z
        sums[k, POINT_PIXELS] += 1.0
