"""Slopes, parts of the variance and state of every cell that is read out (numba, cached).

Each cell is on its own but for the slopes and for the number of readings beside it. Sums are
float32, in the order in which `mapping.cells.elevation_map.read_out` names their terms.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.cells.cell_layers import CellLayers
from mapping.motion.read_out_kernels import PlaceErrors

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]
UInt8Array = NDArray[np.uint8]

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
# Share of the spread of an inclined cell that may lie on one side of it unseen, over its slope
# squared; found on simulated lunar ground, where what is steep over a cell is the rim of something.
_STEEP_SHARE = np.float32(3.0)
# A cell with n readings in a frame has this / n^2 of its height from around it, on top of what
# `_crowding` accounts for; found on simulated lunar ground.
_SPARSE_PX2 = 1.0
# What a reading's place varies by, in squares of the cell's edge: 1/12 inside the cell, and by
# noise 0.38 for a Kinect V1 at 4 m (25 mm) on cells of 4 cm.
_PLACE_SHARE = 0.5
# Neighbours differ by this times the variance around a plane: where a cell has the height of its
# neighbour it is wrong by so much, and nowhere by more.
_NEIGHBOUR_SHARE = 2.0
# Of a float32, the exponent alone is this many times the distance to the next number.
_PER_STEP = np.float32(2.0**-23)
_TWELVE = np.float32(12.0)


class PartConstants(NamedTuple):
    """The settings of those names, and squares of the cell's edge and share of it."""

    edge2_m2: float
    start_m2: float
    mount_m2: float
    relief_share: float
    relief_frames: float
    uncertain_m2: float
    unknown: int
    unconfirmed: int
    measured: int
    uncertain: int
    occluded: int


class Parts(NamedTuple):
    """The layers of `ElevationMap` of these names."""

    elevation_m: Float32Array
    variance_m2: Float32Array
    independent_m2: Float32Array
    systematic_m2: Float32Array
    relief_m2: Float32Array
    pose_m2: Float32Array
    horizontal_m2: Float32Array
    horizontal_xx_m2: Float32Array
    horizontal_xy_m2: Float32Array
    horizontal_yy_m2: Float32Array
    state: UInt8Array


@njit(cache=True, error_model="numpy")
def slopes(
    height_m: Float64Array,
    confirmed: NDArray[np.bool_],
    cell_size_m: float,
    slope_y: Float32Array,
    slope_x: Float32Array,
) -> None:
    """Fill dh/dy and dh/dx: central, one-sided beside a gap, 0 between two gaps."""
    rows, columns = height_m.shape
    for row in range(rows):
        above, below = max(row - 1, 0), min(row + 1, rows - 1)
        for k in range(columns):
            left, right = max(k - 1, 0), min(k + 1, columns - 1)
            here, counts = height_m[row, k], confirmed[row, k]
            slope_y[row, k] = _slope(
                height_m[above, k], here, height_m[below, k],
                counts & confirmed[above, k] & (above != row),
                counts & confirmed[below, k] & (below != row), cell_size_m,
            )  # fmt: skip
            slope_x[row, k] = _slope(
                height_m[row, left], here, height_m[row, right],
                counts & confirmed[row, left] & (left != k),
                counts & confirmed[row, right] & (right != k), cell_size_m,
            )  # fmt: skip


@njit(inline="always")
def _slope(
    before: float, here: float, after: float, has_before: bool, has_after: bool, edge_m: float
) -> np.float32:
    rise = np.float32(after - here) if has_after else _ZERO
    rise += np.float32(here - before) if has_before else _ZERO
    steps = np.float32(2.0) if has_before & has_after else _ONE
    slope: np.float32 = rise / (steps * np.float32(edge_m))
    return slope


@njit(cache=True, error_model="numpy")
def noise_of_heights(
    exponents: Float32Array, variance_m2: Float32Array, moved_m2: Float64Array, out: Float32Array
) -> None:
    """Fill the variance that differs from frame to frame: own, of rounding, and of motions.

    `exponents`: the heights' exponents, as powers of two.
    """
    for row in range(out.shape[0]):
        for k in range(out.shape[1]):
            step = exponents[row, k] * _PER_STEP
            rounding = step * step / _TWELVE
            out[row, k] = variance_m2[row, k] + rounding + np.float32(moved_m2[row, k])


@njit(inline="always")
def _change2(before: np.uint32, after: np.uint32) -> float:
    """Return (d f'/f)^2 for readings whose density f changes exponentially from cell to cell.

    d f' = (after - before) / 2 and, in the middle, f = sqrt(before after). One reading more on
    both sides, lest it be infinite beside a cell without any.
    """
    a, b = float(before) + 1.0, float(after) + 1.0
    return (b - a) * (b - a) / (4.0 * a * b)


@njit(inline="always")
def _crowding(pixels: NDArray[np.uint32], row: int, k: int) -> float:
    """Return the variance that uneven readings make, over the variance around a plane.

    Where the density f of readings changes, those of a cell are not from its middle on average:
    by d^2 / 12 f'/f they lie on the denser side of it, and by sigma^2 f'/f they are from farther
    that way, as noise of sigma moves more readings from there than to there (Tweedie's formula).
    With s d^2 for both and (2 / d^2) variance for the squared slope between neighbours it is
    2 (s d f'/f)^2.
    """
    rows, columns = pixels.shape
    # Beyond the box of the seen cells nothing was seen.
    left = pixels[row, k - 1] if k > 0 else np.uint32(0)
    right = pixels[row, k + 1] if k < columns - 1 else np.uint32(0)
    above = pixels[row - 1, k] if row > 0 else np.uint32(0)
    below = pixels[row + 1, k] if row < rows - 1 else np.uint32(0)
    change2 = _change2(left, right) + _change2(above, below)
    crowding = _NEIGHBOUR_SHARE * (_PLACE_SHARE * _PLACE_SHARE) * change2
    return min(crowding, _NEIGHBOUR_SHARE)


@njit(inline="always")
def _relief(
    own: np.float32, slope2: np.float32, around: np.float32, frames: int, pixels: int,
    crowding: float, c: PartConstants,
) -> np.float32:  # fmt: skip
    """Return what the surface inside a cell makes of its variance; see `read_out`."""
    inclined = slope2 * np.float32(c.edge2_m2 / 12.0)
    relief = np.float32(c.relief_share) * (max(own, _ZERO) + inclined)
    relief += min(_STEEP_SHARE * slope2, _ONE) * inclined
    # More spread than a slope of 60 degrees has: something tall, whose top the bounds must hold.
    relief += max(own - np.float32(c.edge2_m2 / 4.0), _ZERO)
    n = float(max(frames, 1))
    share = n / float(max(pixels, 1))
    unsampled = c.relief_share + c.relief_frames / n + _SPARSE_PX2 * (share * share)
    relief += np.float32(min(unsampled, _NEIGHBOUR_SHARE) + crowding) * around
    return relief


@njit(inline="always")
def _systematic(layers: CellLayers, row: int, k: int) -> np.float32:
    a, b = layers.systematic_a_m[row, k], layers.systematic_b_m[row, k]
    c, bias = layers.systematic_c_m[row, k], layers.systematic_bias_m[row, k]
    total: np.float32 = a * a + b * b + c * c + bias * bias
    return total


@njit(cache=True, error_model="numpy")
def combine(
    layers: CellLayers,
    confirmed: NDArray[np.bool_],
    moved: PlaceErrors,
    slope_y: Float32Array,
    slope_x: Float32Array,
    around: Float32Array,
    c: PartConstants,
    out: Parts,
) -> None:
    """Fill all of `out` but `elevation_m`; `independent_m2` and `elevation_m` come in computed.

    Cells that were not seen get NaN.
    """
    nan = np.float32(np.nan)
    for row in range(confirmed.shape[0]):
        for k in range(confirmed.shape[1]):
            if layers.frames[row, k] == 0:
                for layer in out[:10]:
                    layer[row, k] = nan
                out.state[row, k] = c.occluded if layers.hidden[row, k] else c.unknown
                continue
            y, x = slope_y[row, k], slope_x[row, k]
            xx_m2, xy_m2, yy_m2 = moved.xx_m2[row, k], moved.xy_m2[row, k], moved.yy_m2[row, k]
            horizontal = x * x * xx_m2 + y * y * yy_m2 + np.float32(2.0) * x * y * xy_m2
            out.systematic_m2[row, k] = _systematic(layers, row, k) + np.float32(c.mount_m2)
            out.relief_m2[row, k] = _relief(
                layers.relief_m2[row, k], y * y + x * x, around[row, k],
                layers.frames[row, k], layers.pixels[row, k],
                _crowding(layers.pixels, row, k), c,
            )  # fmt: skip
            out.pose_m2[row, k] = moved.pose_m2[row, k]
            out.horizontal_m2[row, k] = max(horizontal, 0.0)
            variance = out.independent_m2[row, k] + out.systematic_m2[row, k]
            variance += out.relief_m2[row, k]
            variance += out.pose_m2[row, k]
            variance += out.horizontal_m2[row, k]
            out.variance_m2[row, k] = variance
            out.horizontal_xx_m2[row, k] = xx_m2 + c.start_m2
            out.horizontal_xy_m2[row, k] = xy_m2
            out.horizontal_yy_m2[row, k] = yy_m2 + c.start_m2
            state = c.uncertain if variance >= np.float32(c.uncertain_m2) else c.measured
            out.state[row, k] = state if confirmed[row, k] else c.unconfirmed
