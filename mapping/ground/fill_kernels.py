"""The per-cell loops of `mapping.ground.fill` (numba, cached, no fast-math, fixed order of sums).

A gap is looked at along four lines through a cell: a row, a column and both diagonals. On each,
the nearest cells with data before and behind it are found; the height between them is taken on
the straight line. Tables are indexed [kind, nearer, farther, class]: kind 0 are rows and columns, 1
diagonals; the next two are how many cells away the rims are; classes are by the bend between the
line and the ground that leads to it, at the rim where that is larger.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

# Step in rows and in columns, and kind, of the four lines.
_LINES = ((0, 1, 0), (1, 0, 0), (1, 1, 1), (1, -1, 1))


class Source(NamedTuple):
    """The cells with data; all arrays (rows, columns).

    use: which they are; the others may hold anything. The variances are those of `ElevationMap`.
    """

    use: BoolArray
    height_m: Float32Array
    independent_m2: Float32Array
    systematic_m2: Float32Array
    edge_m: float


class Filled(NamedTuple):
    """What was put into gaps; all arrays (rows, columns); `done` tells where."""

    done: BoolArray
    height_m: Float32Array
    independent_m2: Float32Array
    systematic_m2: Float32Array
    shape_m2: Float32Array


@njit(cache=True, error_model="numpy")
def measure_errors(
    source: Source, missing_max: IntArray, limits: Float64Array,
    squares_m2: Float64Array, counts: IntArray,
) -> None:  # fmt: skip
    """Pretend that every cell with data is missing, and add up the errors of straight lines.

    Args:
        source: the cells with data.
        missing_max: for each kind of line, the most cells that may be missing in a row.
        limits: bends at which a new class begins.
        squares_m2, counts: tables of the sums of the squared errors, and of their number.
    """
    rows, columns = source.use.shape
    z = source.height_m
    for dy, dx, kind in _LINES:
        step_m = source.edge_m * np.sqrt(float(dy * dy + dx * dx))
        for i in range(rows):
            for j in range(columns):
                if not source.use[i, j]:
                    continue
                for a in range(1, missing_max[kind] + 1):
                    y, x = i - a * dy, j - a * dx
                    if not _has_data(source.use, y, x):
                        continue
                    for b in range(1, missing_max[kind] + 2 - a):
                        v, u = i + b * dy, j + b * dx
                        if not _has_data(source.use, v, u):
                            continue
                        rise = float(z[v, u]) - float(z[y, x])
                        share = a / (a + b)
                        error = float(z[y, x]) + share * rise - float(z[i, j])
                        run = (a + b) * step_m
                        c = _bend_class(source, y, x, v, u, dy, dx, rise / run, step_m, limits)
                        squares_m2[kind, min(a, b), max(a, b), c] += error * error
                        counts[kind, min(a, b), max(a, b), c] += 1


@njit(cache=True, error_model="numpy", inline="always")
def _bend_class(
    source: Source, y: int, x: int, v: int, u: int, dy: int, dx: int, slope: float, step_m: float,
    limits: Float64Array,
) -> int:  # fmt: skip
    """Return how many limits the larger bend between a line and the ground at its rims reaches.

    The ground's slope is that of the last step to the rim; 0 where the cell before is missing.
    """
    z = source.height_m
    before, behind = 0.0, 0.0
    if _has_data(source.use, y - dy, x - dx):
        before = (float(z[y, x]) - float(z[y - dy, x - dx])) / step_m
    if _has_data(source.use, v + dy, u + dx):
        behind = (float(z[v + dy, u + dx]) - float(z[v, u])) / step_m
    bend = max(abs(slope - before), abs(slope - behind))
    found = 0
    for limit in limits:
        if bend >= limit:
            found += 1
    return found


@njit(cache=True, error_model="numpy", inline="always")
def _has_data(use: BoolArray, row: int, column: int) -> bool:
    rows, columns = use.shape
    return 0 <= row < rows and 0 <= column < columns and bool(use[row, column])


@njit(cache=True, error_model="numpy")
def bridge(
    source: Source, open_: BoolArray, missing_max: IntArray, limits: Float64Array,
    error_m2: Float64Array, out: Filled,
) -> None:  # fmt: skip
    """Fill the open cells that lie between data on at least one line.

    Args:
        source: the cells with data.
        open_: the cells that may be filled.
        missing_max, limits: as for `measure_errors`.
        error_m2: table of the variance of a straight line's error; infinite = not known.
        out: the result, `done` all false before.
    """
    rows, columns = source.use.shape
    lines = np.empty((len(_LINES), 4))
    for i in range(rows):
        for j in range(columns):
            if not open_[i, j]:
                continue
            found = 0
            for dy, dx, kind in _LINES:
                if _line(source, i, j, dy, dx, kind, missing_max, limits, error_m2, lines[found]):
                    found += 1
            if found:
                _combine(lines[:found], i, j, out)


@njit(cache=True, error_model="numpy")
def _line(
    source: Source, i: int, j: int, dy: int, dx: int, kind: int, missing_max: IntArray,
    limits: Float64Array, error_m2: Float64Array, line: Float64Array,
) -> bool:  # fmt: skip
    """Write height, independent, systematic and shape variance of one line; tell if it has any."""
    a = _distance(source.use, i, j, -dy, -dx, missing_max[kind])
    b = _distance(source.use, i, j, dy, dx, missing_max[kind])
    if a == 0 or b == 0 or a + b - 1 > missing_max[kind]:
        return False
    y, x, v, u = i - a * dy, j - a * dx, i + b * dy, j + b * dx
    step_m = source.edge_m * np.sqrt(float(dy * dy + dx * dx))
    rise = float(source.height_m[v, u]) - float(source.height_m[y, x])
    share = a / (a + b)
    slope = rise / ((a + b) * step_m)
    bend = _bend_class(source, y, x, v, u, dy, dx, slope, step_m, limits)
    shape_m2 = error_m2[kind, min(a, b), max(a, b), bend]
    if not np.isfinite(shape_m2):
        return False
    line[0] = float(source.height_m[y, x]) + share * rise
    line[1] = (1.0 - share) * (1.0 - share) * source.independent_m2[y, x]
    line[1] += share * share * source.independent_m2[v, u]
    line[2] = max(source.systematic_m2[y, x], source.systematic_m2[v, u])
    line[3] = shape_m2
    return True


@njit(cache=True, error_model="numpy")
def _distance(use: BoolArray, i: int, j: int, dy: int, dx: int, most: int) -> int:
    """Return how many steps the next cell with data is away; 0 = more than `most`."""
    for k in range(1, most + 1):
        if _has_data(use, i + k * dy, j + k * dx):
            return k
    return 0


@njit(cache=True, error_model="numpy")
def _combine(lines: Float64Array, i: int, j: int, out: Filled) -> None:
    """Write the mean of the lines, weighted by 1 / variance.

    Their errors may be alike: the sigma of a weighted mean is then at most the weighted mean of
    the sigmas. What the lines differ among themselves comes on top.
    """
    total = 0.0
    mean = np.zeros(4)
    for line in lines:
        weight = 1.0 / (line[1] + line[2] + line[3])
        total += weight
        mean[0] += weight * line[0]
        for k in range(1, 4):
            mean[k] += weight * np.sqrt(line[k])
    mean /= total
    spread = 0.0
    for line in lines:
        weight = 1.0 / (line[1] + line[2] + line[3])
        spread += weight / total * (line[0] - mean[0]) * (line[0] - mean[0])
    out.done[i, j] = True
    out.height_m[i, j] = mean[0]
    out.independent_m2[i, j] = mean[1] * mean[1]
    out.systematic_m2[i, j] = mean[2] * mean[2]
    out.shape_m2[i, j] = mean[3] * mean[3] + spread
