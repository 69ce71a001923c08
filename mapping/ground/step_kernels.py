"""The step layers of `mapping.ground.layers` (numba, cached).

Discs are given as in `mapping.ground.layer_kernels`. A row of cells is widened step by step, and
what it has at a width goes to all discs that reach it at that width.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.ground.surface_kernels import lower_row, raise_row

Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int64]


@njit(cache=True, error_model="numpy")
def step_heights(
    height_m: Float32Array,
    use: NDArray[np.bool_],
    half: IntArray,
    cells_min: int,
    out: Float32Array,
) -> None:
    """Write the range of heights in every disc.

    Args:
        height_m, use: (rows, columns) the heights, and which of them count.
        half: the disc.
        cells_min: discs with fewer cells get NaN, and those whose centre does not count.
        out: the result.
    """
    reach = half.size - 1
    rows, columns = use.shape
    # The discs that are not complete yet; that of row t at [t % rows of a disc].
    period = 2 * reach + 1
    discs = np.zeros((3, period, columns), np.float32)
    discs[0], discs[1] = -np.inf, np.inf
    line = np.zeros((3, columns + 2 * reach), np.float32)
    high, low, one = line[0], line[1], line[2]
    sums = np.empty((3, columns), np.float32)
    high[:], low[:] = -np.inf, np.inf
    for i in range(rows + reach):
        if i < rows:
            for j in range(columns):
                counts = use[i, j]
                high[reach + j] = height_m[i, j] if counts else -np.float32(np.inf)
                low[reach + j] = height_m[i, j] if counts else np.float32(np.inf)
                one[reach + j] = np.float32(counts)
            sums[0], sums[1], sums[2] = -np.inf, np.inf, 0.0
            for width in range(half[0] + 1):
                for start in range(reach - width, reach + width + 1, max(2 * width, 1)):
                    raise_row(sums[0], high[start:])
                    lower_row(sums[1], low[start:])
                    _add(sums[2], one[start:])
                for dy in range(-reach, reach + 1):
                    if half[abs(dy)] == width:
                        place = (i - dy) % period
                        raise_row(discs[0, place], sums[0])
                        lower_row(discs[1, place], sums[1])
                        _add(discs[2, place], sums[2])
        place = (i - reach) % period
        if i >= reach:
            for j in range(columns):
                counts = use[i - reach, j] & (discs[2, place, j] >= cells_min)
                step = discs[0, place, j] - discs[1, place, j]
                out[i - reach, j] = step if counts else np.float32(np.nan)
        discs[0, place], discs[1, place], discs[2, place] = -np.inf, np.inf, 0.0


@njit(cache=True, error_model="numpy")
def supported_steps(
    steps: Float32Array, half: IntArray, critical_m: float, critical_cells: int, out: Float32Array
) -> None:
    """Write min(1, steps above critical / critical_cells) times the largest step of every disc.

    Args:
        steps: (rows, columns) as `step_heights` writes them.
        half: the disc.
        critical_m, critical_cells: a step counts from this height, and fully with so many.
        out: the result, NaN where the centre has no step.
    """
    reach = half.size - 1
    rows, columns = steps.shape
    period = 2 * reach + 1
    discs = np.zeros((2, period, columns), np.float32)
    line = np.zeros(columns + 2 * reach, np.float32)
    high = np.zeros_like(line)
    sums = np.empty((2, columns), np.float32)
    for i in range(rows + reach):
        if i < rows:
            for j in range(columns):
                step = steps[i, j]
                line[reach + j] = step if step >= 0.0 else np.float32(0.0)
                high[reach + j] = np.float32(step > critical_m)
            sums[:] = 0.0
            for width in range(half[0] + 1):
                for start in range(reach - width, reach + width + 1, max(2 * width, 1)):
                    raise_row(sums[0], line[start:])
                    _add(sums[1], high[start:])
                for dy in range(-reach, reach + 1):
                    if half[abs(dy)] == width:
                        place = (i - dy) % period
                        raise_row(discs[0, place], sums[0])
                        _add(discs[1, place], sums[1])
        place = (i - reach) % period
        if i >= reach:
            for j in range(columns):
                share = min(1.0, discs[1, place, j] / critical_cells)
                is_step = steps[i - reach, j] >= 0.0
                out[i - reach, j] = discs[0, place, j] * share if is_step else np.nan
        discs[0, place], discs[1, place] = 0.0, 0.0


@njit(cache=True, error_model="numpy")
def _add(total: Float32Array, values: Float32Array) -> None:
    for j in range(total.size):
        total[j] += values[j]
