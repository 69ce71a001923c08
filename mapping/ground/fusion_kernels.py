"""The integral over each cell's horizontal ellipse (numba, cached, fixed order).

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

# The ellipse reaches this far, in sigma.
REACH_SIGMA = 3.5
_REACH2 = REACH_SIGMA**2
# A place that is less certain than 100 cells counts as if it were known to 100 cells.
_LARGEST = 100.0**2
# An ellipse is sampled this far along x and y, in blocks, or up to that where it is slender.
_SAMPLES, _MOST_SAMPLES = 5.0, 12
# Below this variance, in squares of a sample's distance, the neighbours have no weight.
_NARROWEST = 0.02
# Cells that are worked on together: all their numbers stay in the first-level cache.
CHUNK = 128
# Rows of the work on a chunk: inverse of the ellipse's matrix; weights of one sample in x, in x
# and y, in y, and what they are multiplied by from sample to sample; the weight of the sample, and
# 0 or infinity where it is outside; the sums.
_A_XX, _A_XY, _A_YY, _GX, _QX, _GY, _QY, _CROSS, _BACK, _LEAN, _LEFT, _W, _OUT = range(
    0, 13 * CHUNK, CHUNK
)
_QX0, _QXY, _QY2, _SUM, _SUM_H, _SUM_HH, _LOW, _HIGH, _SIZE = range(13 * CHUNK, 22 * CHUNK, CHUNK)


class Surface(NamedTuple):
    """What is integrated, at cells or blocks of them; arrays (rows, columns) with a margin.

    share: cells that count. height_m: sum of their heights above `level_m`. square_m2: sum of
    height^2 + vertical variance. lower_m, upper_m: vertical bounds, inf and -inf where none counts.
    """

    share: Float64Array
    height_m: Float64Array
    square_m2: Float64Array
    lower_m: Float64Array
    upper_m: Float64Array


class Places(NamedTuple):
    """Horizontal covariance of the cells of a window, in squares of a cell's edge.

    blocks: edge of the blocks at which a cell's ellipse is sampled, 0 = the cell does not count.
    """

    xx: Float32Array
    xy: Float32Array
    yy: Float32Array
    blocks: NDArray[np.int64]


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
    reach_x, reach_y = int(np.sqrt(_REACH2 * a_xx)), int(np.sqrt(_REACH2 * a_yy))
    return _Form(a_yy * inverse, -a_xy * inverse, a_xx * inverse, reach_x, reach_y)


@njit(cache=True, error_model="numpy")
def _begin(
    b: Float64Array,
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
    for c in range(min(CHUNK, blocks.size - column)):
        k = column + c
        if blocks[k] != block:
            b[_A_XX + c], b[_A_XY + c], b[_A_YY + c] = np.inf, 0.0, np.inf
            b[_QX0 + c], b[_QXY + c], b[_QY + c] = 0.0, 1.0, 0.0
            continue
        a = _form(
            float(places.xx[row, k]),
            float(places.xy[row, k]),
            float(places.yy[row, k]),
            block,
            table,
        )
        reach_x, reach_y = max(reach_x, a.reach_x), max(reach_y, a.reach_y)
        b[_A_XX + c], b[_A_XY + c], b[_A_YY + c] = a.xx, a.xy, a.yy
        b[_QX0 + c], b[_QXY + c] = np.exp(-0.5 * a.xx), np.exp(-a.xy)
        b[_QY + c] = np.exp(-0.5 * a.yy)
        b[_QY2 + c] = b[_QY + c] * b[_QY + c]
    for c in range(CHUNK):
        p = np.uint64(here + c)
        b[_GY + c], b[_CROSS + c], b[_BACK + c] = 1.0, 1.0, 1.0
        b[_SUM + c], b[_SUM_H + c], b[_SUM_HH + c] = s.share[p], s.height_m[p], s.square_m2[p]
        b[_LOW + c], b[_HIGH + c] = s.lower_m[p], s.upper_m[p]
    return reach_x, reach_y


@njit(cache=True, error_model="numpy")
def _weigh(b: Float64Array, i: int, j: int, lean: int) -> bool:
    """Find the weights of the samples (i, j): exp(-o' A^-1 o / 2) inside the ellipse, else 0.

    Returns whether any is inside.
    """
    xx, xy, yy = float(i * i), 2.0 * i * j, float(j * j)
    found = 0
    for c in range(CHUNK):
        square = b[_A_XX + c] * xx + b[_A_XY + c] * xy + b[_A_YY + c] * yy
        inside = square <= _REACH2
        b[_W + c] = b[_GX + c] * b[_GY + c] * b[lean + c] if inside else 0.0
        b[_OUT + c] = 0.0 if inside else np.inf
        found += 1 if inside else 0
    return found > 0


@njit(inline="always")
def _add_sums(b: Float64Array, row: int, layer: Float64Array, here: int, away: int) -> None:
    """Add what is at the samples on either side of each cell, times their weight."""
    p, q = np.uint64(here + away), np.uint64(here - away)
    for c in range(CHUNK):
        k = np.uint64(c)
        b[row + c] += b[_W + c] * (layer[p + k] + layer[q + k])


@njit(inline="always")
def _add_bounds(b: Float64Array, s: Surface, here: int, away: int) -> None:
    """Take the bounds of the samples on either side that are inside."""
    p, q = np.uint64(here + away), np.uint64(here - away)
    for c in range(CHUNK):
        k = np.uint64(c)
        low, other = s.lower_m[p + k], s.lower_m[q + k]
        low = (low if low < other else other) + b[_OUT + c]
        b[_LOW + c] = low if low < b[_LOW + c] else b[_LOW + c]
    for c in range(CHUNK):
        k = np.uint64(c)
        high, other = s.upper_m[p + k], s.upper_m[q + k]
        high = (high if high > other else other) - b[_OUT + c]
        b[_HIGH + c] = high if high > b[_HIGH + c] else b[_HIGH + c]


@njit(cache=True, error_model="numpy")
def _add_samples(b: Float64Array, s: Surface, here: int, away: int) -> None:
    _add_sums(b, _SUM, s.share, here, away)
    _add_sums(b, _SUM_H, s.height_m, here, away)
    _add_sums(b, _SUM_HH, s.square_m2, here, away)
    _add_bounds(b, s, here, away)


@njit(cache=True, error_model="numpy")
def _next_sample(b: Float64Array) -> None:
    """Go one sample to the right and to the left: q_x^(i i), q_cross^(i j)."""
    for c in range(CHUNK):
        b[_GX + c] *= b[_QX + c]
        b[_QX + c] *= b[_QX0 + c] * b[_QX0 + c]
        b[_LEAN + c] *= b[_CROSS + c]
        b[_LEFT + c] *= b[_BACK + c]


@njit(cache=True, error_model="numpy")
def _next_line(b: Float64Array, j: int) -> None:
    """Go to the j-th line of samples: q_y^(j j), q_cross^j."""
    for c in range(CHUNK):
        if j > 0:
            b[_GY + c] *= b[_QY + c]
            b[_QY + c] *= b[_QY2 + c]
            b[_CROSS + c] *= b[_QXY + c]
            b[_BACK + c] /= b[_QXY + c]
        b[_GX + c], b[_LEAN + c], b[_LEFT + c] = 1.0, 1.0, 1.0
        b[_QX + c] = b[_QX0 + c]


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
    b = np.zeros(_SIZE)
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
                _next_line(b, j)
                for i in range(reach_x + 1):
                    if i > 0:
                        _next_sample(b)
                    if i + j > 0 and _weigh(b, i, j, _LEAN):
                        _add_samples(b, flat, here, (j * line + i) * block)
                    if i > 0 and j > 0 and _weigh(b, -i, j, _LEFT):
                        _add_samples(b, flat, here, (j * line - i) * block)
            _finish(b, places.blocks[row], row, column, block, level_m, out)


@njit(cache=True, error_model="numpy")
def _finish(
    b: Float64Array,
    blocks: NDArray[np.int64],
    row: int,
    column: int,
    block: int,
    level_m: float,
    out: Fused,
) -> None:
    """Turn the sums of a chunk into mean, variance and bounds."""
    for c in range(min(CHUNK, blocks.size - column)):
        if blocks[column + c] == block:
            mean = b[_SUM_H + c] / b[_SUM + c]
            out.elevation_m[row, column + c] = level_m + mean
            out.variance_m2[row, column + c] = max(b[_SUM_HH + c] / b[_SUM + c] - mean * mean, 0.0)
            out.lower_m[row, column + c] = b[_LOW + c]
            out.upper_m[row, column + c] = b[_HIGH + c]
