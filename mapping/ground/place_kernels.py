"""The ellipses that cells are fused over, and how each is sampled (numba, cached).

An ellipse that is wider than a few cells is sampled at blocks of n x n cells, n odd, instead of at
cells: the sums over a block stand at its middle. Sampling at every n-th cell then leaves none out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int64]

# The ellipse reaches this far, in sigma.
REACH_SIGMA = 3.5
# A place that is less certain than 100 cells counts as if it were known to 100 cells.
_LARGEST = 100.0**2
# An ellipse is sampled this far along x and y, in blocks, or up to that where it is slender.
_SAMPLES, _MOST_SAMPLES = 5.0, 12
# No block is larger: a reach of 350 cells in 5 samples.
_LARGEST_BLOCK = 71
_TINY = np.float32(1e-30)


class Places(NamedTuple):
    """Horizontal covariance of the cells of a window, in squares of a cell's edge.

    blocks: edge of the blocks at which a cell's ellipse is sampled, 0 = the cell does not count.
    """

    xx: Float32Array
    xy: Float32Array
    yy: Float32Array
    blocks: IntArray


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
            block = max(block, _odd_above(reach / _MOST_SAMPLES), 1)
            out.blocks[row, column] = min(block, _LARGEST_BLOCK)
            out.xx[row, column], out.xy[row, column], out.yy[row, column] = xx, xy, yy


@njit(cache=True, error_model="numpy")
def widest_places(places: Places) -> Float32Array:
    """Return the largest variance along an axis of all places with blocks of each size."""
    widest = np.zeros(_LARGEST_BLOCK + 1, np.float32)
    for row in range(places.blocks.shape[0]):
        for column in range(places.blocks.shape[1]):
            k = places.blocks[row, column]
            wide = max(places.xx[row, column], places.yy[row, column])
            # The smallest number stands for places that are known exactly.
            widest[k] = max(widest[k], wide, _TINY)
    return widest
