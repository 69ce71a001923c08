"""The integral over each cell's horizontal ellipse (numba, cached, fixed order)."""

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
# Below this variance, in squares of a cell's edge, the neighbours have no weight.
_NARROWEST = 0.02
# An ellipse that is longer than this many cells to a side is sampled at every n-th cell.
_SAMPLES = 12


class Surface(NamedTuple):
    """What is integrated; arrays (rows, columns) with a margin that no ellipse reaches beyond.

    share: 1 where a cell counts, else 0. height_m, variance_m2: mean and vertical variance, 0 where
    it does not. lower_m, upper_m: vertical bounds, inf and -inf where it does not.
    """

    share: Float32Array
    height_m: Float32Array
    variance_m2: Float32Array
    lower_m: Float32Array
    upper_m: Float32Array


class Places(NamedTuple):
    """Horizontal covariance of the cells of a window, in squares of a cell's edge."""

    xx: Float32Array
    xy: Float32Array
    yy: Float32Array


class Fused(NamedTuple):
    """What comes out: arrays of the window's shape, filled where a cell counts."""

    elevation_m: Float32Array
    variance_m2: Float32Array
    lower_m: Float32Array
    upper_m: Float32Array


class _Form(NamedTuple):
    """Inverse of the ellipse's matrix; step between samples, in cells."""

    xx: float
    xy: float
    yy: float
    step: int


class _Line(NamedTuple):
    """A line of samples: first and last column, first weight, ratio of the second to it."""

    first: int
    last: int
    weight: float
    ratio: float


@njit(inline="always")
def _widened(variance: float, table: Float64Array) -> float:
    """Return the width whose samples at whole cells have this variance; see `narrow_table`."""
    place = variance * (table.size - 1)
    if place >= table.size - 1:
        return variance
    k = int(place)
    share = place - k
    return float((1.0 - share) * table[k] + share * table[k + 1])


@njit(inline="always")
def _form(xx: float, xy: float, yy: float, table: Float64Array) -> _Form:
    """Return the ellipse of a covariance, its eigenvalues widened where they are narrow."""
    middle, half = 0.5 * (xx + yy), 0.5 * (xx - yy)
    spread = np.sqrt(half * half + xy * xy)
    wide_large = _widened(max(middle + spread, _NARROWEST), table)
    wide_small = _widened(max(middle - spread, _NARROWEST), table)
    # f(S) = a I + b S has the same axes as S, also where S is no covariance.
    slope = (wide_large - wide_small) / (2.0 * spread) if spread > 1e-6 * middle else 1.0
    offset = wide_small - slope * (middle - spread)
    a_xx, a_xy, a_yy = offset + slope * xx, slope * xy, offset + slope * yy
    step = 1 + int(np.sqrt(_REACH2 * wide_large) / _SAMPLES)
    inverse = step * step / (a_xx * a_yy - a_xy * a_xy)
    return _Form(a_yy * inverse, -a_xy * inverse, a_xx * inverse, step)


@njit(inline="always")
def _line(a: _Form, j: int, q_x: float, cross: float, weight: float) -> _Line:
    """Return where the j-th line of samples begins and ends, and how its weights go on.

    `cross`: q_cross^j. `weight`: that of the sample straight below the cell.
    """
    lean, narrower = a.xy / a.xx, a.yy - a.xy * a.xy / a.xx
    half = np.sqrt(max(_REACH2 - j * j * narrower, 0.0) / a.xx)
    first, last = int(np.ceil(-lean * j - half)), int(np.floor(-lean * j + half))
    first = max(first, 1) if j == 0 else first
    ratio = q_x * cross
    if first < 0:
        back = q_x / cross
        for _ in range(-first):
            weight *= back
            back *= q_x * q_x
        ratio = q_x * q_x / back
    for _ in range(first):
        weight *= ratio
        ratio *= q_x * q_x
    return _Line(first, last, weight, ratio)


@njit(cache=True, error_model="numpy")
def integrate(
    s: Surface, places: Places, first_row: int, first_column: int, table: Float64Array, out: Fused
) -> None:
    """Fill `out` for the window whose corner is at that row and column of the surface.

    Weights exp(-o' A^-1 o / 2) = q_x^(i i) q_cross^(i j) q_y^(j j), from one sample to the next by
    multiplication. The half of the ellipse above the cell is the mirror of the half below.
    """
    share, height_m, variance_m2 = (
        s.share.reshape(-1),
        s.height_m.reshape(-1),
        s.variance_m2.reshape(-1),
    )
    lower_m, upper_m = s.lower_m.reshape(-1), s.upper_m.reshape(-1)
    line = s.share.shape[1]
    for row in range(out.elevation_m.shape[0]):
        for column in range(out.elevation_m.shape[1]):
            # An unsigned index spares the compiler the case of one below 0.
            here = np.uint64((first_row + row) * line + first_column + column)
            if share[here] == 0.0:
                continue
            xx, xy, yy = places.xx[row, column], places.xy[row, column], places.yy[row, column]
            a = _form(float(xx), float(xy), float(yy), table)
            height = float(height_m[here])
            weights, rises, squares = 1.0, 0.0, float(variance_m2[here])
            low, high = lower_m[here], upper_m[here]
            q_x, q_cross, q_y = np.exp(-0.5 * a.xx), np.exp(-a.xy), np.exp(-0.5 * a.yy)
            below, cross, q2_y = 1.0, 1.0, q_y * q_y
            for j in range(int(np.sqrt(_REACH2 * a.xx / (a.xx * a.yy - a.xy * a.xy))) + 1):
                first, last, weight, ratio = _line(a, j, q_x, cross, below)
                for i in range(first, last + 1):
                    away = np.uint64((j * line + i) * a.step)
                    p, q = here + away, here - away
                    w, w_q = weight * share[p], weight * share[q]
                    rise, rise_q = height_m[p] - height, height_m[q] - height
                    weights += w + w_q
                    rises += w * rise + w_q * rise_q
                    squares += w * (rise * rise + variance_m2[p])
                    squares += w_q * (rise_q * rise_q + variance_m2[q])
                    low = min(low, min(lower_m[p], lower_m[q]))
                    high = max(high, max(upper_m[p], upper_m[q]))
                    weight *= ratio
                    ratio *= q_x * q_x
                below *= q_y
                q_y *= q2_y
                cross *= q_cross
            rise = rises / weights
            out.elevation_m[row, column] = height + rise
            out.variance_m2[row, column] = max(squares / weights - rise * rise, 0.0)
            out.lower_m[row, column] = low
            out.upper_m[row, column] = high
