"""How rough the map is around each cell (numba, cached, fixed order)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float64Array = NDArray[np.float64]

_HALF_WIDTH = 2
_WIDTH = 2 * _HALF_WIDTH + 1
_FEWEST_CELLS = 6
# Columns that are worked on together: their sums stay in the first-level cache, and stand at
# constant distances from each other, so that the compiler can turn loops into vector instructions.
_CHUNK = 152
# Sums over cells of a row: ones, x, x^2, height h, h x, h^2, noise; over rows also those with y.
_N, _X, _XX, _H, _HX, _HH, _NOISE, _ROW_SUMS = range(0, 8 * _CHUNK, _CHUNK)
_Y, _XY, _YY, _HY, _ALL_SUMS = range(7 * _CHUNK, 12 * _CHUNK, _CHUNK)


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
    is_defined = (n >= _FEWEST_CELLS) & (determinant > 1e-9 * n * n * n)
    d = n * yy - y * y
    e = x * y - n * xy
    f = n * xx - x * x
    level = a * h + b * hx + c * hy
    slope_x = b * h + d * hx + e * hy
    slope_y = c * h + e * hx + f * hy
    explained = (level * h + slope_x * hx + slope_y * hy) / (determinant if is_defined else 1.0)
    residual = hh - explained
    residual = residual if is_defined & (residual > 0.0) else 0.0
    return float(residual / (n - 3.0 if is_defined else 1.0))


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
    ring = np.zeros((_WIDTH, _ROW_SUMS))
    line = np.zeros((3, _CHUNK + 2 * _HALF_WIDTH))
    total, relief = np.empty(_ALL_SUMS), np.empty(_CHUNK, np.float32)
    for first in range(0, columns, _CHUNK):
        ring[:] = 0.0
        for below in range(rows + _HALF_WIDTH):
            sums = ring[below % _WIDTH]
            sums[:] = 0.0
            if below < rows:
                _load(height_m[below], variance_m2[below], confirmed[below], middle_m, first, line)
                for u in range(_WIDTH):
                    _add_column(sums, line, u)
            j = below - _HALF_WIDTH
            if j >= 0:
                total[:] = 0.0
                for v in range(-_HALF_WIDTH, _HALF_WIDTH + 1):
                    _add_row(total, ring[(j + v) % _WIDTH], float(v))
                _finish(total, relief)
                for k in range(first, min(first + _CHUNK, columns)):
                    relief_m2[j, k] = relief[k - first] if confirmed[j, k] else np.float32(0.0)


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
    first: int,
    line: Float64Array,
) -> None:
    """Write 1, height and variance of a row's cells from 2 before `first` on.

    Zeros where a cell is not confirmed, or beyond the map.
    """
    line[:] = 0.0
    start = max(first - _HALF_WIDTH, 0)
    end = min(first + _CHUNK + _HALF_WIDTH, height_m.size)
    for i in range(start, end):
        known, k = confirmed[i], i - first + _HALF_WIDTH
        line[0, k] = 1.0 if known else 0.0
        line[1, k] = height_m[i] - middle_m if known else 0.0
        line[2, k] = variance_m2[i] if known else 0.0


@njit(cache=True, error_model="numpy")
def _add_column(sums: Float64Array, line: Float64Array, u: int) -> None:
    """Add the cells that are `u` - 2 columns away to the sums of a row."""
    x = float(u - _HALF_WIDTH)
    ones, heights, noise = line[0][u:], line[1][u:], line[2][u:]
    for i in range(_CHUNK):
        n, h = ones[i], heights[i]
        sums[_N + i] += n
        sums[_X + i] += x * n
        sums[_XX + i] += x * x * n
        sums[_H + i] += h
        sums[_HX + i] += x * h
        sums[_HH + i] += h * h
        sums[_NOISE + i] += noise[i]


@njit(cache=True, error_model="numpy")
def _add_row(total: Float64Array, sums: Float64Array, v: float) -> None:
    """Add the sums of the row that is `v` rows away."""
    for i in range(_CHUNK):
        n, h = sums[_N + i], sums[_H + i]
        total[_N + i] += n
        total[_X + i] += sums[_X + i]
        total[_XX + i] += sums[_XX + i]
        total[_H + i] += h
        total[_HX + i] += sums[_HX + i]
        total[_HH + i] += sums[_HH + i]
        total[_NOISE + i] += sums[_NOISE + i]
        total[_Y + i] += v * n
        total[_XY + i] += v * sums[_X + i]
        total[_YY + i] += v * v * n
        total[_HY + i] += v * h


@njit(cache=True, error_model="numpy")
def _finish(total: Float64Array, relief_m2: NDArray[np.float32]) -> None:
    """Write the relief of a row of cells."""
    for i in range(_CHUNK):
        n, h, hh = total[_N + i], total[_H + i], total[_HH + i]
        terms = (
            n, total[_X + i], total[_Y + i], total[_XX + i], total[_XY + i], total[_YY + i],
            h, total[_HX + i], total[_HY + i], hh,
        )  # fmt: skip
        rough = _plane_residual(terms) - total[_NOISE + i] / (n if n > 1.0 else 1.0)
        relief_m2[i] = np.float32(rough if rough > 0.0 else 0.0)
