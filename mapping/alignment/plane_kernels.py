"""Planes through the cells of a map (numba, cached, fixed order of sums)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float64Array = NDArray[np.float64]
UInt32Array = NDArray[np.uint32]

# Columns of the planes: height at the cell's centre, gradient along x and y, variance of the
# heights around the plane (below 0: there is none), variance of each gradient.
PLANE_HEIGHT, PLANE_SLOPE_X, PLANE_SLOPE_Y, PLANE_VARIANCE, PLANE_SLOPE_VARIANCE = range(5)
PLANE_COLUMNS = 5

_NO_PLANE = -1.0
# Of the 3 x 3 cells; a plane has three numbers, and its spread needs as many again.
_FEWEST_CELLS = 6


class WindowPlace(NamedTuple):
    """A window of cells: its first row and column in the layers, which wrap around; its size."""

    first_row: int
    first_column: int
    cells_x: int
    cells_y: int
    cell_size_m: float


@njit(inline="always")
def _sum_around(
    height_m: Float64Array,
    frames: UInt32Array,
    pixels: UInt32Array,
    p: WindowPlace,
    j: int,
    i: int,
    fewest_pixels: int,
    s: Float64Array,
) -> None:
    """Fill s with the sums of 1, x, y, xx, xy, yy, h, hx, hy, hh over the 3 x 3 known cells.

    x, y in cells and h relative to the middle one.
    """
    rows, columns = height_m.shape
    middle = height_m[(p.first_row + j) % rows, (p.first_column + i) % columns]
    s[:] = 0.0
    for v in range(max(j - 1, 0), min(j + 2, p.cells_y)):
        row = (p.first_row + v) % rows
        for u in range(max(i - 1, 0), min(i + 2, p.cells_x)):
            column = (p.first_column + u) % columns
            if frames[row, column] > 0 and pixels[row, column] >= fewest_pixels:
                x, y = float(u - i), float(v - j)
                h = height_m[row, column] - middle
                s[0] += 1.0
                s[1] += x
                s[2] += y
                s[3] += x * x
                s[4] += x * y
                s[5] += y * y
                s[6] += h
                s[7] += h * x
                s[8] += h * y
                s[9] += h * h


@njit(inline="always")
def _fit(s: Float64Array, height_m: float, cell_size_m: float, plane: Float64Array) -> None:
    """Fill the plane from the sums: Cramer's rule on the normal equations.

    It takes the height of the cell itself: the mean of 3 x 3 would cut off crests.
    """
    n, x, y, xx, xy, yy, h, hx, hy, hh = s
    a = xx * yy - xy * xy
    b = xy * y - x * yy
    c = x * xy - xx * y
    e = x * y - n * xy
    f = n * yy - y * y
    g = n * xx - x * x
    determinant = n * a + x * b + y * c
    if n < _FEWEST_CELLS or determinant <= 1e-9 * n * n * n:
        return
    level = (a * h + b * hx + c * hy) / determinant
    slope_x = (b * h + f * hx + e * hy) / determinant
    slope_y = (c * h + e * hx + g * hy) / determinant
    left = max(hh - level * h - slope_x * hx - slope_y * hy, 0.0) / (n - 3.0)
    plane[PLANE_HEIGHT] = height_m
    plane[PLANE_SLOPE_X] = slope_x / cell_size_m
    plane[PLANE_SLOPE_Y] = slope_y / cell_size_m
    plane[PLANE_VARIANCE] = left
    # Planes that fit well by chance weigh more; that makes noise count (n - 3) / (n - 5) times.
    slope_variance = left * max(f, g) / determinant * (n - 3.0) / (n - 5.0)
    plane[PLANE_SLOPE_VARIANCE] = slope_variance / (cell_size_m * cell_size_m)


@njit(cache=True, error_model="numpy")
def fit_planes(
    height_m: Float64Array,
    frames: UInt32Array,
    pixels: UInt32Array,
    place: WindowPlace,
    fewest_pixels: int,
    planes: Float64Array,
) -> None:
    """Fit a plane to the 3 x 3 cells around every cell of a window: least squares of the heights.

    Args:
        height_m, frames, pixels: layers of the map.
        place: the window.
        fewest_pixels: cells with fewer readings do not count.
        planes: (cells of the window, PLANE_COLUMNS), is filled.
    """
    rows, columns = height_m.shape
    sums = np.empty(10)
    for j in range(place.cells_y):
        row = (place.first_row + j) % rows
        for i in range(place.cells_x):
            column = (place.first_column + i) % columns
            plane = planes[j * place.cells_x + i]
            plane[PLANE_VARIANCE] = _NO_PLANE
            if frames[row, column] > 0 and pixels[row, column] >= fewest_pixels:
                _sum_around(height_m, frames, pixels, place, j, i, fewest_pixels, sums)
                _fit(sums, height_m[row, column], place.cell_size_m, plane)
