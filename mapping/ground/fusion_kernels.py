"""The integral over each cell's horizontal ellipse (numba, cached, fixed order).

Heights are counted from that of the cell in the middle: their squares are then as small as what
they differ by, and float32 holds them to 1e-6 of the variance. Cells are worked on in chunks, each
loop over a few arrays and without a branch, so that the compiler turns it into vector instructions.

An ellipse that is wider than a few cells is sampled at blocks of n x n cells, n odd, instead of at
cells: the sums over a block stand at its middle. Sampling at every n-th cell then leaves none out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

# The ellipse reaches this far, in sigma.
REACH_SIGMA = 3.5
_REACH2 = np.float32(REACH_SIGMA**2)
# A place that is less certain than 100 cells counts as if it were known to 100 cells.
_LARGEST = 100.0**2
# An ellipse is sampled this far along x and y, in blocks, or up to that where it is slender.
_SAMPLES, _MOST_SAMPLES = 5.0, 12
# Below this variance, in squares of a sample's distance, the neighbours have no weight.
_NARROWEST = 0.02
# Cells that are worked on together: all their numbers stay in the first-level cache.
CHUNK = 64
# Rows of the work on a chunk: inverse of the ellipse's matrix; height of the middle; weight of a
# sample, 0 where it is outside; the sums.
_A_XX, _A_XY, _A_YY, _MIDDLE, _W, _SUM, _SUM_H, _SUM_HH, _LOW, _HIGH, _SIZE = range(
    0, 11 * CHUNK, CHUNK
)
_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
# exp(-u) = 1 - u (1 - u / 2 (1 - u / 3 (...))).
_HALF, _THIRD, _FOURTH, _FIFTH = (np.float32(1.0 / k) for k in (2, 3, 4, 5))
_PER_32 = np.float32(1.0 / 32.0)


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


class Places(NamedTuple):
    """Horizontal covariance of the cells of a window, in squares of a cell's edge.

    blocks: edge of the blocks at which a cell's ellipse is sampled, 0 = the cell does not count.
    """

    xx: Float32Array
    xy: Float32Array
    yy: Float32Array
    blocks: IntArray


class Fused(NamedTuple):
    """What comes out: arrays of the window's shape, filled where a cell counts."""

    elevation_m: Float32Array
    variance_m2: Float32Array
    lower_m: Float32Array
    upper_m: Float32Array


class _Form(NamedTuple):
    """Inverse of the ellipse's matrix, and how far it reaches; in samples."""

    xx: float
    xy: float
    yy: float
    reach_x: int
    reach_y: int


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
            _lower(low, s.lower_m[v])
            _raise(high, s.upper_m[v])
        inside = columns - 2 * half
        total = np.zeros((3, inside))
        lower, upper = out.lower_m[row][half:][:inside], out.upper_m[row][half:][:inside]
        for u in range(block):
            for k in range(3):
                _add(total[k], sums[k][u:][:inside])
            _lower(lower, low[u:][:inside])
            _raise(upper, high[u:][:inside])
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
def _lower(bottom: Float32Array, values: Float32Array) -> None:
    for k in range(bottom.size):
        bottom[k] = min(bottom[k], values[k])


@njit(cache=True, error_model="numpy")
def _raise(top: Float32Array, values: Float32Array) -> None:
    for k in range(top.size):
        top[k] = max(top[k], values[k])


@njit(inline="always")
def _odd_above(size: float) -> int:
    return 2 * int(np.ceil(max(0.5 * (size - 1.0), 0.0))) + 1


@njit(inline="always")
def _odd_below(size: float) -> int:
    return 2 * int(max(0.5 * (size - 1.0), 0.0)) + 1


@njit(cache=True, error_model="numpy")
def choose_blocks(
    xx_m2: Float32Array,
    xy_m2: Float32Array,
    yy_m2: Float32Array,
    use: NDArray[np.bool_],
    per_m2: float,
    out: Places,
) -> None:
    """Fill `out` for the cells in `use`: covariance in cells^2, and the edge of the blocks.

    Blocks as large as a few samples allow, but such that what is left of the ellipse's narrow side
    without their own width is half a block wide: narrower, samples across its axes miss it.
    """
    for row in range(use.shape[0]):
        for column in range(use.shape[1]):
            if not use[row, column]:
                continue
            xx, xy, yy = xx_m2[row, column], xy_m2[row, column], yy_m2[row, column]
            scale = per_m2 * min(_LARGEST / max((xx + yy) * per_m2, _LARGEST), 1.0)
            xx, xy, yy = xx * scale, xy * scale, yy * scale
            half = 0.5 * (xx - yy)
            narrow = max(0.5 * (xx + yy) - np.sqrt(half * half + xy * xy), 0.0)
            reach = REACH_SIGMA * np.sqrt(max(xx, yy))
            block = min(_odd_above(reach / _SAMPLES), _odd_below(np.sqrt(3.0 * narrow)))
            out.blocks[row, column] = max(block, _odd_above(reach / _MOST_SAMPLES))
            out.xx[row, column], out.xy[row, column], out.yy[row, column] = xx, xy, yy


@njit(inline="always")
def _widened(variance: float, table: Float64Array) -> float:
    """Return the width whose samples have this variance; see `narrow_table`."""
    place = variance * (table.size - 1)
    if place >= table.size - 1:
        return variance
    k = int(place)
    share = place - k
    return float((1.0 - share) * table[k] + share * table[k + 1])


@njit(inline="always")
def _form(xx: float, xy: float, yy: float, block: int, table: Float64Array) -> _Form:
    """Return the ellipse of a covariance, its eigenvalues widened where they are narrow.

    What a block is wide, (n^2 - 1) / 12 cells^2, is taken off: its cells add it by themselves.
    """
    scale, own = 1.0 / (block * block), (block * block - 1.0) / 12.0
    xx, xy, yy = (xx - own) * scale, xy * scale, (yy - own) * scale
    middle, half = 0.5 * (xx + yy), 0.5 * (xx - yy)
    spread = np.sqrt(half * half + xy * xy)
    wide_large = _widened(max(middle + spread, _NARROWEST), table)
    wide_small = _widened(max(middle - spread, _NARROWEST), table)
    # f(S) = a I + b S has the same axes as S, also where S is no covariance.
    slope = (wide_large - wide_small) / (2.0 * spread) if spread > 1e-6 * abs(middle) else 0.0
    offset = 0.5 * (wide_large + wide_small) - slope * middle
    a_xx, a_xy, a_yy = offset + slope * xx, slope * xy, offset + slope * yy
    inverse = 1.0 / (a_xx * a_yy - a_xy * a_xy)
    reach_x, reach_y = int(REACH_SIGMA * np.sqrt(a_xx)), int(REACH_SIGMA * np.sqrt(a_yy))
    return _Form(a_yy * inverse, -a_xy * inverse, a_xx * inverse, reach_x, reach_y)


@njit(cache=True, error_model="numpy")
def _begin(
    b: Float32Array,
    s: Surface,
    here: int,
    places: Places,
    row: int,
    column: int,
    block: int,
    table: Float64Array,
) -> tuple[int, int]:
    """Prepare a chunk whose first cell is at `here` of the surface; return how far it reaches."""
    reach_x, reach_y = -1, 0
    blocks = places.blocks[row]
    b[: 3 * CHUNK] = np.inf  # where no cell is, no sample is inside
    for c in range(min(CHUNK, blocks.size - column)):
        k = column + c
        if blocks[k] == block:
            a = _form(
                float(places.xx[row, k]),
                float(places.xy[row, k]),
                float(places.yy[row, k]),
                block,
                table,
            )
            reach_x, reach_y = max(reach_x, a.reach_x), max(reach_y, a.reach_y)
            b[_A_XX + c], b[_A_XY + c], b[_A_YY + c] = a.xx, a.xy, a.yy
    for c in range(CHUNK):
        p = np.uint64(here + c)
        b[_MIDDLE + c], b[_SUM + c], b[_SUM_H + c] = s.height_m[p], s.share[p], _ZERO
        b[_SUM_HH + c] = s.square_m2[p]
        b[_LOW + c], b[_HIGH + c] = s.lower_m[p], s.upper_m[p]
    return reach_x, reach_y


@njit(cache=True, error_model="numpy")
def _weigh(b: Float32Array, i: int, j: int) -> bool:
    """Find the weights of the samples (i, j): exp(-o' A^-1 o / 2) inside the ellipse, else 0.

    exp(-s / 2) = exp(-s / 32)^16, by its first terms: at the rim, where the weight is 0.002, to
    7e-5 of it. Returns whether any sample is inside.
    """
    xx, xy, yy = np.float32(i * i), np.float32(2 * i * j), np.float32(j * j)
    found = np.int32(0)
    for c in range(CHUNK):
        square = b[_A_XX + c] * xx + b[_A_XY + c] * xy + b[_A_YY + c] * yy
        u = square * _PER_32
        e = _ONE - u * (
            _ONE - u * _HALF * (_ONE - u * _THIRD * (_ONE - u * _FOURTH * (_ONE - u * _FIFTH)))
        )
        e *= e
        e *= e
        e *= e
        e *= e
        inside = square <= _REACH2
        b[_W + c] = e if inside else _ZERO
        found |= np.int32(inside)
    return bool(found > 0)


@njit(inline="always")
def _add_heights(
    b: Float32Array, share: Float32Array, height: Float32Array, here: int, away: int
) -> None:
    """Add cells, heights and squares at the samples on either side of each cell by weight."""
    p, q = np.uint64(here + away), np.uint64(here - away)
    for c in range(CHUNK):
        k = np.uint64(c)
        weight, other = b[_W + c] * share[p + k], b[_W + c] * share[q + k]
        rise, fall = height[p + k] - b[_MIDDLE + c], height[q + k] - b[_MIDDLE + c]
        b[_SUM + c] += weight + other
        b[_SUM_H + c] += weight * rise + other * fall
        b[_SUM_HH + c] += weight * rise * rise + other * fall * fall


@njit(inline="always")
def _add_squares(b: Float32Array, square: Float32Array, here: int, away: int) -> None:
    """Add what the samples have of squares by themselves."""
    p, q = np.uint64(here + away), np.uint64(here - away)
    for c in range(CHUNK):
        k = np.uint64(c)
        b[_SUM_HH + c] += b[_W + c] * (square[p + k] + square[q + k])


@njit(inline="always")
def _add_bounds(b: Float32Array, s: Surface, here: int, away: int) -> None:
    """Take the bounds of the samples on either side that are inside."""
    p, q = np.uint64(here + away), np.uint64(here - away)
    for c in range(CHUNK):
        k = np.uint64(c)
        low, other = s.lower_m[p + k], s.lower_m[q + k]
        low = low if low < other else other
        b[_LOW + c] = low if (low < b[_LOW + c]) & (b[_W + c] > _ZERO) else b[_LOW + c]
    for c in range(CHUNK):
        k = np.uint64(c)
        high, other = s.upper_m[p + k], s.upper_m[q + k]
        high = high if high > other else other
        b[_HIGH + c] = high if (high > b[_HIGH + c]) & (b[_W + c] > _ZERO) else b[_HIGH + c]


@njit(cache=True, error_model="numpy")
def _add_samples(b: Float32Array, s: Surface, here: int, away: int) -> None:
    _add_heights(b, s.share, s.height_m, here, away)
    _add_squares(b, s.square_m2, here, away)
    _add_bounds(b, s, here, away)


@njit(cache=True, error_model="numpy")
def integrate(
    s: Surface,
    places: Places,
    first: tuple[int, int],
    block: int,
    level_m: float,
    table: Float64Array,
    out: Fused,
) -> None:
    """Fill `out` for the cells of a window that are sampled at these blocks.

    Args:
        s: sums over blocks, as many columns wider than the window as a chunk is.
        places: the ellipses.
        first: row and column of the surface at which the window's corner is.
        block: edge of the blocks, in cells.
        level_m: what heights are counted from.
        table: see `narrow_table`.
        out: the result.
    """
    line = s.share.shape[1]
    b = np.zeros(_SIZE, np.float32)
    flat = Surface(
        s.share.reshape(-1),
        s.height_m.reshape(-1),
        s.square_m2.reshape(-1),
        s.lower_m.reshape(-1),
        s.upper_m.reshape(-1),
    )
    for row in range(out.elevation_m.shape[0]):
        for column in range(0, out.elevation_m.shape[1], CHUNK):
            here = (first[0] + row) * line + first[1] + column
            reach_x, reach_y = _begin(b, flat, here, places, row, column, block, table)
            if reach_x < 0:
                continue
            for j in range(reach_y + 1):
                for i in range(-reach_x if j > 0 else 1, reach_x + 1):
                    if _weigh(b, i, j):
                        _add_samples(b, flat, here, (j * line + i) * block)
            _finish(b, places.blocks[row], row, column, block, level_m, out)


@njit(cache=True, error_model="numpy")
def _finish(
    b: Float32Array,
    blocks: IntArray,
    row: int,
    column: int,
    block: int,
    level_m: float,
    out: Fused,
) -> None:
    """Turn the sums of a chunk into mean, variance and bounds."""
    for c in range(min(CHUNK, blocks.size - column)):
        if blocks[column + c] == block:
            above = b[_SUM_H + c] / b[_SUM + c]
            square = b[_SUM_HH + c] / b[_SUM + c]
            out.elevation_m[row, column + c] = level_m + b[_MIDDLE + c] + above
            out.variance_m2[row, column + c] = max(square - above * above, _ZERO)
            out.lower_m[row, column + c] = level_m + b[_LOW + c]
            out.upper_m[row, column + c] = level_m + b[_HIGH + c]
