"""The surface that is fused, at cells and at blocks of them (numba, cached, fixed order)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)


class Surface(NamedTuple):
    """What is integrated, at cells or blocks of them; arrays (rows, columns) with a margin.

    share: cells that count. height_m: mean of their heights above a level. square_m2: sum of
    (height - mean)^2 + vertical variance. lower_m, upper_m: vertical bounds above the level, inf
    and -inf where none counts.
    """

    share: Float32Array
    height_m: Float32Array
    square_m2: Float32Array
    lower_m: Float32Array
    upper_m: Float32Array


@njit(cache=True, error_model="numpy")
def mean_height(height_m: Float32Array, use: NDArray[np.bool_]) -> float:
    """Return the mean of the heights in `use`, 0 where there is none."""
    total, count = 0.0, 0
    for row in range(use.shape[0]):
        for column in range(use.shape[1]):
            total += float(height_m[row, column]) if use[row, column] else 0.0
            count += use[row, column]
    return total / max(count, 1)


@njit(cache=True, error_model="numpy")
def load_surface(
    height_m: Float32Array,
    variance_m2: Float32Array,
    horizontal_m2: Float32Array,
    use: NDArray[np.bool_],
    level_m: float,
    margin: int,
    out: Surface,
) -> None:
    """Fill the inside of `out` with the cells in `use`, their variance without the place's part."""
    columns = use.shape[1]
    for row in range(use.shape[0]):
        share, height = out.share[row + margin][margin:], out.height_m[row + margin][margin:]
        square = out.square_m2[row + margin][margin:]
        lower, upper = out.lower_m[row + margin][margin:], out.upper_m[row + margin][margin:]
        for k in range(columns):
            counts = use[row, k]
            above = np.float32(height_m[row, k] - level_m) if counts else _ZERO
            vertical = variance_m2[row, k] - horizontal_m2[row, k]
            vertical = vertical if counts & (vertical > _ZERO) else _ZERO
            bound = np.float32(3.0) * np.sqrt(vertical)
            share[k], height[k], square[k] = _ONE if counts else _ZERO, above, vertical
            lower[k] = above - bound if counts else np.float32(np.inf)
            upper[k] = above + bound if counts else np.float32(-np.inf)


@njit(cache=True, error_model="numpy")
def over_blocks(s: Surface, block: int, out: Surface) -> None:
    """Fill `out`, as an empty surface before, with what the block around every cell of `s` holds.

    Cells that have no block around them are in the margin, where no cell counts.
    """
    rows, columns = s.share.shape
    half = block // 2
    sums, low, high = np.empty((3, columns)), np.empty_like(s.share[0]), np.empty_like(s.share[0])
    for row in range(half, rows - half):
        sums[:], low[:], high[:] = 0.0, np.inf, -np.inf
        for v in range(row - half, row + half + 1):
            _add_row(sums, s.share[v], s.height_m[v], s.square_m2[v])
            lower_row(low, s.lower_m[v])
            raise_row(high, s.upper_m[v])
        inside = columns - 2 * half
        total = np.zeros((3, inside))
        lower, upper = out.lower_m[row][half:][:inside], out.upper_m[row][half:][:inside]
        for u in range(block):
            for k in range(3):
                _add(total[k], sums[k][u:][:inside])
            lower_row(lower, low[u:][:inside])
            raise_row(upper, high[u:][:inside])
        for k in range(inside):
            n = total[0, k]
            mean = total[1, k] / max(n, 1.0)
            out.share[row, half + k], out.height_m[row, half + k] = n, mean
            out.square_m2[row, half + k] = max(total[2, k] - mean * total[1, k], 0.0)


@njit(cache=True, error_model="numpy")
def _add_row(
    sums: Float64Array, share: Float32Array, height: Float32Array, square: Float32Array
) -> None:
    """Add cells, heights, and squares with variances of a row of cells."""
    for k in range(share.size):
        h = float(height[k])
        sums[0, k] += share[k]
        sums[1, k] += h
        sums[2, k] += h * h + square[k]


@njit(cache=True, error_model="numpy")
def _add(total: Float64Array, values: Float64Array) -> None:
    for k in range(total.size):
        total[k] += values[k]


@njit(cache=True, error_model="numpy")
def lower_row(bottom: Float32Array, values: Float32Array) -> None:
    """Lower what is higher than the values."""
    for k in range(bottom.size):
        bottom[k] = values[k] if values[k] < bottom[k] else bottom[k]


@njit(cache=True, error_model="numpy")
def raise_row(top: Float32Array, values: Float32Array) -> None:
    """Raise what is lower than the values."""
    for k in range(top.size):
        top[k] = values[k] if values[k] > top[k] else top[k]
