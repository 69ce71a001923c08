"""The integral over each cell's horizontal ellipse (numba, cached, fixed order).

Heights are counted from that of the cell in the middle: their squares are then as small as what
they differ by, and float32 holds them to 1e-6 of the variance. Cells are worked on in chunks, each
loop over a few arrays and without a branch, so that the compiler turns it into vector instructions.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.ground.place_kernels import REACH_SIGMA, Places
from mapping.ground.surface_kernels import Surface

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

_REACH2 = np.float32(REACH_SIGMA**2)
# Below this variance, in squares of a sample's distance, the neighbours have no weight.
_NARROWEST = 0.02
# Cells that are worked on together: all their numbers stay in the first-level cache.
CHUNK = 64
# Rows of the work on a chunk: inverse of the ellipse's matrix; height of the middle; weight of a
# sample, 0 where it is outside; the sums.
_A_XX, _A_XY, _A_YY, _MIDDLE, _W, _SUM, _SUM_H, _SUM_HH, _LOW, _HIGH, _SIZE = range(
    0, 11 * CHUNK, CHUNK
)
# Rows of what the inverse matrix is found from: covariance, half the eigenvalues' difference, and
# the eigenvalues.
_XX, _XY, _YY, _SPREAD, _LARGE, _SMALL, _FORM = range(0, 7 * CHUNK, CHUNK)
_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
# exp(-u) = 1 - u (1 - u / 2 (1 - u / 3 (...))).
_HALF, _THIRD, _FOURTH, _FIFTH = (np.float32(1.0 / k) for k in (2, 3, 4, 5))
_PER_32 = np.float32(1.0 / 32.0)


class Fused(NamedTuple):
    """What comes out: arrays of the window's shape, filled where a cell counts."""

    elevation_m: Float32Array
    variance_m2: Float32Array
    lower_m: Float32Array
    upper_m: Float32Array


@njit(inline="always")
def _widened(variance: float, table: Float64Array) -> float:
    """Return the width whose samples have this variance; see `narrow_table`."""
    place = variance * (table.size - 1)
    if place >= table.size - 1:
        return variance
    k = int(place)
    share = place - k
    return float((1.0 - share) * table[k] + share * table[k + 1])


@njit(cache=True, error_model="numpy")
def _find_axes(
    f: Float64Array, xx: Float32Array, xy: Float32Array, yy: Float32Array, block: int
) -> None:
    """Find the eigenvalues of a chunk's covariances, in samples.

    What a block is wide, (n^2 - 1) / 12 cells^2, is taken off: its cells add it by themselves.
    """
    scale, own = 1.0 / (block * block), (block * block - 1.0) / 12.0
    for c in range(xx.size):
        x, y, cross = (xx[c] - own) * scale, (yy[c] - own) * scale, xy[c] * scale
        middle, half = 0.5 * (x + y), 0.5 * (x - y)
        spread = np.sqrt(half * half + cross * cross)
        large, small = middle + spread, middle - spread
        f[_XX + c], f[_XY + c], f[_YY + c], f[_SPREAD + c] = x, cross, y, spread
        f[_LARGE + c] = large if large > _NARROWEST else _NARROWEST
        f[_SMALL + c] = small if small > _NARROWEST else _NARROWEST


@njit(cache=True, error_model="numpy")
def _invert(b: Float32Array, f: Float64Array, blocks: IntArray, block: int) -> None:
    """Write the inverse matrices of a chunk's ellipses, their eigenvalues as `f` has them now.

    f(S) = a I + b S has the same axes as S, also where S is no covariance.
    """
    for c in range(blocks.size):
        middle, spread = 0.5 * (f[_XX + c] + f[_YY + c]), f[_SPREAD + c]
        is_long = spread > 1e-6 * abs(middle)
        rise = f[_LARGE + c] - f[_SMALL + c]
        slope = (rise if is_long else 0.0) / (2.0 * spread if is_long else 1.0)
        offset = 0.5 * (f[_LARGE + c] + f[_SMALL + c]) - slope * middle
        xx, xy, yy = offset + slope * f[_XX + c], slope * f[_XY + c], offset + slope * f[_YY + c]
        inverse = 1.0 / (xx * yy - xy * xy)
        mine = blocks[c] == block
        b[_A_XX + c] = yy * inverse if mine else np.inf
        b[_A_XY + c] = -xy * inverse if mine else np.inf
        b[_A_YY + c] = xx * inverse if mine else np.inf
        f[_XX + c], f[_YY + c] = xx if mine else -1.0, yy if mine else -1.0


@njit(cache=True, error_model="numpy")
def _begin(
    b: Float32Array,
    f: Float64Array,
    s: Surface,
    here: int,
    places: Places,
    row: int,
    column: int,
    block: int,
    table: Float64Array,
) -> tuple[int, int]:
    """Prepare a chunk whose first cell is at `here` of the surface; return how far it reaches."""
    blocks = places.blocks[row][column:][:CHUNK]
    if not (blocks == block).any():
        return -1, 0
    b[: 3 * CHUNK] = np.inf  # where no cell is, no sample is inside
    xx, xy = places.xx[row][column:][:CHUNK], places.xy[row][column:][:CHUNK]
    _find_axes(f, xx, xy, places.yy[row][column:][:CHUNK], block)
    for c in range(blocks.size):
        f[_LARGE + c] = _widened(f[_LARGE + c], table)
        f[_SMALL + c] = _widened(f[_SMALL + c], table)
    _invert(b, f, blocks, block)
    widest_x, widest_y = -1.0, -1.0
    for c in range(blocks.size):
        widest_x, widest_y = max(widest_x, f[_XX + c]), max(widest_y, f[_YY + c])
    _load_middle(b, s, here)
    return int(REACH_SIGMA * np.sqrt(widest_x)), int(REACH_SIGMA * np.sqrt(widest_y))


@njit(cache=True, error_model="numpy")
def _load_middle(b: Float32Array, s: Surface, here: int) -> None:
    """Begin the sums with the cells themselves."""
    for c in range(CHUNK):
        p = np.uint64(here + c)
        b[_MIDDLE + c], b[_SUM + c], b[_SUM_H + c] = s.height_m[p], s.share[p], _ZERO
        b[_SUM_HH + c] = s.square_m2[p]
        b[_LOW + c], b[_HIGH + c] = s.lower_m[p], s.upper_m[p]


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
    b, f = np.zeros(_SIZE, np.float32), np.zeros(_FORM)
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
            reach_x, reach_y = _begin(b, f, flat, here, places, row, column, block, table)
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
