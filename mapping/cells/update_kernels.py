"""The per-cell loop: one frame's sums per cell in, one Kalman update per cell out (numba, cached).

All arithmetic is float64; most stored layers are float32. The loop runs over the window row by row,
each cell on its own, so its result does not depend on the order. All compiled code of the update
is in this file: numba looks for changes in the file of a cached kernel, not in what it calls.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.cells.cell_layers import CellLayers
from mapping.cells.update_constants import FrameConstants, FusionConstants

Float64Array = NDArray[np.float64]

_MOST_PIXELS = 2.0**32 - 1.0


class Systematic(NamedTuple):
    """Height change in metres for one sigma of each constant error; see `CellLayers`."""

    a_m: float
    b_m: float
    c_m: float
    bias_m: float


class Measurement(NamedTuple):
    """One frame's word on one cell.

    height_m in T; own_m2: variance from pixel noise and from sampling the surface inside the
    cell; common_m2: from the frame's pose; systematic: see `CellLayers`; relief_m2: spread of the
    surface inside the cell.
    """

    height_m: float
    own_m2: float
    common_m2: float
    systematic: Systematic
    relief_m2: float
    pixels: float


class UpdateCounts(NamedTuple):
    """What happened to the cells of one frame."""

    cells: int
    rejected: int
    replaced: int


@njit(inline="always")
def _systematic(c: FrameConstants, x: float, y: float, rise: float) -> Systematic:
    """Sensitivity of height to the constant errors, for a point l = (x, y, rise) from the camera.

    Mount, a small rotation d of the sensor in its own axes: dh = e . (C d x l) = (C' (l x e)) . d
    with l x e = (y, -x, 0). Bias: moves the point along its ray, dh = rise / z dz; the middle of a
    large cell may be nearer than any reading.
    """
    depth = max(c.r02 * x + c.r12 * y + c.r22 * rise, c.range_min_m)
    bias = rise / depth * (c.bias_0_m + c.bias_2_per_m * depth * depth)
    return Systematic(
        c.mount_rad * (c.r00 * y - c.r10 * x),
        c.mount_rad * (c.r01 * y - c.r11 * x),
        c.mount_rad * (c.r02 * y - c.r12 * x),
        bias,
    )


@njit(inline="always")
def _common_m2(c: FrameConstants, x: float, y: float) -> float:
    """J Sigma_pose J' with J = [e, (r_y, -r_x, 0)], r = lever arm from the tracked body.

    Yaw has no entry: turning the rover moves no height.
    """
    rx = x + c.lever_x_m
    ry = y + c.lever_y_m
    variance = (
        c.pose_zz
        + ry * ry * c.pose_aa
        + rx * rx * c.pose_bb
        + 2.0 * (ry * c.pose_za - rx * c.pose_zb - rx * ry * c.pose_ab)
    )
    return max(variance, 0.0)


@njit(inline="always")
def _clamp(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


@njit(inline="always")
def _reduce(sums: Float64Array, k: int, j: int, i: int, c: FrameConstants) -> Measurement:
    """Precision-weighted mean of the cell's pixels and its variance n / (N_eff sum w)."""
    n = sums[k, 3]
    weight = sums[k, 0]
    mean = sums[k, 1] / weight
    spread = max(sums[k, 2] / weight - mean * mean, 0.0)
    noise_m2 = n / weight
    relief = spread * n / (n - 1.0) - noise_m2 if n > 1.0 else 0.0
    own = noise_m2 / max(n / c.correlation_area_px, 1.0) + max(relief, 0.0) / n
    x = c.corner_x_m + (i + 0.5) * c.cell_size_m
    y = c.corner_y_m + (j + 0.5) * c.cell_size_m
    return Measurement(
        mean + c.camera_z_m, own, _common_m2(c, x, y), _systematic(c, x, y, mean), relief, n
    )


@njit(inline="always")
def _get_systematic(layers: CellLayers, row: int, column: int) -> Systematic:
    return Systematic(
        float(layers.systematic_a_m[row, column]),
        float(layers.systematic_b_m[row, column]),
        float(layers.systematic_c_m[row, column]),
        float(layers.systematic_bias_m[row, column]),
    )


@njit(inline="always")
def _set_systematic(layers: CellLayers, row: int, column: int, s: Systematic) -> None:
    layers.systematic_a_m[row, column] = s.a_m
    layers.systematic_b_m[row, column] = s.b_m
    layers.systematic_c_m[row, column] = s.c_m
    layers.systematic_bias_m[row, column] = s.bias_m


@njit(inline="always")
def _blend(s: Systematic, other: Systematic, gain: float) -> Systematic:
    """Return (1 - gain) s + gain other."""
    return Systematic(
        s.a_m + gain * (other.a_m - s.a_m),
        s.b_m + gain * (other.b_m - s.b_m),
        s.c_m + gain * (other.c_m - s.c_m),
        s.bias_m + gain * (other.bias_m - s.bias_m),
    )


@njit(inline="always")
def _dot(s: Systematic, other: Systematic) -> float:
    return s.a_m * other.a_m + s.b_m * other.b_m + s.c_m * other.c_m + s.bias_m * other.bias_m


@njit(inline="always")
def _begin(
    layers: CellLayers, row: int, column: int, m: Measurement, t_ns: int, f: FusionConstants
) -> None:
    """First measurement of a cell."""
    layers.elevation_m[row, column] = m.height_m
    layers.variance_m2[row, column] = _clamp(m.own_m2 + m.common_m2, f.floor_m2, f.ceiling_m2)
    _set_systematic(layers, row, column, m.systematic)
    layers.relief_m2[row, column] = m.relief_m2
    layers.candidate_hits[row, column] = 0
    layers.frames[row, column] = 1
    layers.pixels[row, column] = np.uint32(m.pixels)
    layers.last_ns[row, column] = t_ns


@njit(inline="always")
def _update(
    layers: CellLayers, row: int, column: int, m: Measurement, t_ns: int, f: FusionConstants
) -> None:
    """Update of a known cell with a measurement inside the gate.

    V, R: variances that differ from frame to frame; s, m: sensitivities to the constant errors,
    of map and measurement. The gain that minimises (1 - K)^2 V + K^2 R + |(1 - K) s + K m|^2 is
    the Kalman gain where s = m, prefers the nearer view where they differ, and lets views from
    opposite sides cancel a crooked mount. A common error with correlation time tau that is seen
    again after dt < 2 tau brings no fresh information: it counts as variance * 2 tau / dt.
    """
    since = max(float(t_ns - layers.last_ns[row, column]), 1.0)
    repeated = max(2.0 * f.correlation_time_ns / since, 1.0)
    measured = m.own_m2 + m.common_m2 * repeated
    known = float(layers.variance_m2[row, column])
    height = float(layers.elevation_m[row, column])
    systematic = _get_systematic(layers, row, column)
    relief = float(layers.relief_m2[row, column])
    pixels = float(layers.pixels[row, column])
    crossed = _dot(systematic, m.systematic)
    own = _dot(systematic, systematic)
    other = _dot(m.systematic, m.systematic)
    total = known + measured + max(own + other - 2.0 * crossed, 0.0)
    gain = _clamp((known + own - crossed) / total, 0.0, 1.0)
    rest = 1.0 - gain
    layers.elevation_m[row, column] = height + gain * (m.height_m - height)
    layers.variance_m2[row, column] = _clamp(
        rest * rest * known + gain * gain * measured, f.floor_m2, f.ceiling_m2
    )
    _set_systematic(layers, row, column, _blend(systematic, m.systematic, gain))
    # Each frame's spread has one degree of freedom less than it has pixels.
    freedom = m.pixels - 1.0
    share = freedom / max(freedom + pixels - float(layers.frames[row, column]), 1.0)
    layers.relief_m2[row, column] = relief + share * (m.relief_m2 - relief)
    layers.candidate_hits[row, column] = max(layers.candidate_hits[row, column], 1) - 1
    layers.frames[row, column] += np.uint32(1)
    layers.pixels[row, column] = np.uint32(min(pixels + m.pixels, _MOST_PIXELS))
    layers.last_ns[row, column] = t_ns


@njit(inline="always")
def _challenge(
    layers: CellLayers, row: int, column: int, m: Measurement, t_ns: int, f: FusionConstants
) -> bool:
    """Give a measurement outside the gate to the second hypothesis; True when that takes over."""
    hits = layers.candidate_hits[row, column]
    known = float(layers.candidate_m2[row, column])
    innovation = m.height_m - float(layers.candidate_m[row, column])
    variance = known + m.own_m2 + 2.0 * m.common_m2 + max(m.relief_m2, 0.0)
    if hits > 0 and innovation * innovation <= f.gate2 * variance:
        gain = known / (known + m.own_m2)
        layers.candidate_m[row, column] += gain * innovation
        layers.candidate_m2[row, column] = (1.0 - gain) * known
        hits += 1
    else:
        layers.candidate_m[row, column] = m.height_m
        layers.candidate_m2[row, column] = m.own_m2
        hits = 1
    layers.candidate_hits[row, column] = hits
    if hits < f.confirmations:
        return False
    winner = float(layers.candidate_m[row, column])
    # The pose's error is common to hits that follow each other: it was not averaged away.
    variance = float(layers.candidate_m2[row, column]) + m.common_m2
    _begin(layers, row, column, m, t_ns, f)
    layers.elevation_m[row, column] = winner
    layers.variance_m2[row, column] = _clamp(variance, f.floor_m2, f.ceiling_m2)
    layers.frames[row, column] = np.uint32(f.confirmations)
    # Earlier hits had a pixel at least; fewer pixels than frames would upset the relief's share.
    layers.pixels[row, column] = np.uint32(max(m.pixels, float(f.confirmations)))
    return True


@njit(inline="always")
def _agrees(
    layers: CellLayers,
    row: int,
    column: int,
    m: Measurement,
    cell_size_m: float,
    f: FusionConstants,
) -> bool:
    """Gate: squared innovation against the variance of both sides, all in m^2.

    A frame's relief counts as far as a slope can make it, (d/2)^2 at 60 degrees: more is the flank
    of something tall, which must not pass for ground because it is tall.
    """
    innovation = m.height_m - float(layers.elevation_m[row, column])
    variance = float(layers.variance_m2[row, column]) + m.own_m2 + m.common_m2
    systematic = _get_systematic(layers, row, column)
    variance += _dot(systematic, systematic) + _dot(m.systematic, m.systematic)
    slope_m2 = 0.25 * cell_size_m * cell_size_m
    variance += max(min(m.relief_m2, slope_m2), float(layers.relief_m2[row, column]), 0.0)
    return innovation * innovation <= f.gate2 * variance


@njit(cache=True, error_model="numpy")
def fuse(
    sums: Float64Array, c: FrameConstants, f: FusionConstants, layers: CellLayers
) -> UpdateCounts:
    """Fuse one frame into the layers; `sums` (cells_y * cells_x, 4) is cleared behind it."""
    rows, columns = layers.elevation_m.shape
    cells = 0
    rejected = 0
    replaced = 0
    for j in range(c.cells_y):
        row = (c.first_row + j) % rows
        for i in range(c.cells_x):
            k = j * c.cells_x + i
            if sums[k, 3] == 0.0:
                continue
            column = (c.first_column + i) % columns
            m = _reduce(sums, k, j, i, c)
            sums[k] = 0.0
            cells += 1
            if layers.frames[row, column] == 0:
                _begin(layers, row, column, m, c.t_ns, f)
            elif _agrees(layers, row, column, m, c.cell_size_m, f):
                _update(layers, row, column, m, c.t_ns, f)
            else:
                rejected += 1
                replaced += _challenge(layers, row, column, m, c.t_ns, f)
    return UpdateCounts(cells, rejected, replaced)
