"""How rough the map is around each cell (numba, cached, fixed order)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float64Array = NDArray[np.float64]

_HALF_WIDTH = 2
_WIDTH = 2 * _HALF_WIDTH + 1
# Sums over cells of a row: ones, x, x^2, height h, h x, h^2, noise; over rows also those with y.
_N, _X, _XX, _H, _HX, _HH, _NOISE, _ROW_SUMS = range(8)
_Y, _XY, _YY, _HY, _ALL_SUMS = range(7, 12)
_FEWEST_CELLS = 6


@njit(inline="always")
def _plane_residual(s: tuple[float, ...]) -> float:
    """Return the residual variance of a plane through points, from their sums; 0 if undefined.

    s: 1, x, y, xx, xy, yy, h, hx, hy, hh. Cramer's rule on the normal equations.
    """
    n, x, y, xx, xy, yy, h, hx, hy, hh = s
    a = xx * yy - xy * xy
    b = xy * y - x * yy
    c = x * xy - xx * y
    determinant = n * a + x * b + y * c
    if n < _FEWEST_CELLS or determinant <= 1e-9 * n * n * n:
        return 0.0
    d = n * yy - y * y
    e = x * y - n * xy
    f = n * xx - x * x
    level = a * h + b * hx + c * hy
    slope_x = b * h + d * hx + e * hy
    slope_y = c * h + e * hx + f * hy
    explained = (level * h + slope_x * hx + slope_y * hy) / determinant
    return float(max(hh - explained, 0.0) / (n - 3.0))


@njit(cache=True, error_model="numpy")
def surrounding_relief(
    height_m: Float64Array,
    variance_m2: NDArray[np.float32],
    confirmed: NDArray[np.bool_],
    relief_m2: NDArray[np.float32],
) -> None:
    """Fill `relief_m2`: variance of the heights in 5 x 5 cells around a plane through them.

    What their own noise explains is taken off. 0 where fewer than six confirmed cells, or only
    cells in a line, are there. Arrays (rows, columns).
    """
    rows, columns = height_m.shape
    middle_m = _mean(height_m, confirmed)
    # Sums over 5 cells of a row; those of row j at [j % 5].
    ring = np.zeros((_WIDTH, _ROW_SUMS, columns))
    line = np.zeros((3, columns + 2 * _HALF_WIDTH))
    total = np.empty((_ALL_SUMS, columns))
    for below in range(rows + _HALF_WIDTH):
        sums = ring[below % _WIDTH]
        sums[:] = 0.0
        if below < rows:
            _load(height_m[below], variance_m2[below], confirmed[below], middle_m, line)
            for u in range(_WIDTH):
                _add_column(sums, line, u)
        j = below - _HALF_WIDTH
        if j >= 0:
            total[:] = 0.0
            for v in range(-_HALF_WIDTH, _HALF_WIDTH + 1):
                _add_row(total, ring[(j + v) % _WIDTH], float(v))
            _finish(total, confirmed[j], relief_m2[j])


@njit(cache=True, error_model="numpy")
def _mean(height_m: Float64Array, confirmed: NDArray[np.bool_]) -> float:
    """Return the mean height: around it, sums of squares keep their digits."""
    total, count = 0.0, 0
    for j in range(height_m.shape[0]):
        for i in range(height_m.shape[1]):
            if confirmed[j, i]:
                total += height_m[j, i]
                count += 1
    return total / max(count, 1)


@njit(cache=True, error_model="numpy")
def _load(
    height_m: Float64Array,
    variance_m2: NDArray[np.float32],
    confirmed: NDArray[np.bool_],
    middle_m: float,
    line: Float64Array,
) -> None:
    """Write 1, height and variance of the cells of a row; zeros where one is not confirmed."""
    for i in range(height_m.size):
        known = confirmed[i]
        line[0, i + _HALF_WIDTH] = 1.0 if known else 0.0
        line[1, i + _HALF_WIDTH] = height_m[i] - middle_m if known else 0.0
        line[2, i + _HALF_WIDTH] = variance_m2[i] if known else 0.0


@njit(cache=True, error_model="numpy")
def _add_column(sums: Float64Array, line: Float64Array, u: int) -> None:
    """Add the cells that are `u` - 2 columns away to the sums of a row."""
    columns = sums.shape[1]
    x = float(u - _HALF_WIDTH)
    ones, heights = line[0][u : u + columns], line[1][u : u + columns]
    noise = line[2][u : u + columns]
    for i in range(columns):
        n, h = ones[i], heights[i]
        sums[_N, i] += n
        sums[_X, i] += x * n
        sums[_XX, i] += x * x * n
        sums[_H, i] += h
        sums[_HX, i] += x * h
        sums[_HH, i] += h * h
        sums[_NOISE, i] += noise[i]


@njit(cache=True, error_model="numpy")
def _add_row(total: Float64Array, sums: Float64Array, v: float) -> None:
    """Add the sums of the row that is `v` rows away."""
    for i in range(total.shape[1]):
        n, h = sums[_N, i], sums[_H, i]
        total[_N, i] += n
        total[_X, i] += sums[_X, i]
        total[_XX, i] += sums[_XX, i]
        total[_H, i] += h
        total[_HX, i] += sums[_HX, i]
        total[_HH, i] += sums[_HH, i]
        total[_NOISE, i] += sums[_NOISE, i]
        total[_Y, i] += v * n
        total[_XY, i] += v * sums[_X, i]
        total[_YY, i] += v * v * n
        total[_HY, i] += v * h


@njit(cache=True, error_model="numpy")
def _finish(
    total: Float64Array, confirmed: NDArray[np.bool_], relief_m2: NDArray[np.float32]
) -> None:
    """Write the relief of a row of cells."""
    for i in range(relief_m2.size):
        t = total[:, i]
        n = max(t[_N], 1.0)
        terms = (t[_N], t[_X], t[_Y], t[_XX], t[_XY], t[_YY], t[_H], t[_HX], t[_HY], t[_HH])
        rough = max(_plane_residual(terms) - t[_NOISE] / n, 0.0)
        relief_m2[i] = rough if confirmed[i] else 0.0
