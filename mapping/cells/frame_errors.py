"""What a frame's errors make of one cell: formulas without arrays (numba, inlined).

A frame's own noise is fresh in every frame only where the camera moves: see "A camera at rest" in
docs/decisions/0003-variance.md.
"""

from __future__ import annotations

from numba import njit

from mapping.cells.update_constants import FrameConstants
from mapping.cells.update_types import Known, Measurement, Systematic

# A cell with n pixels of a frame has this / n^2 of its noise, at most all, from a single image row.
_SPARSE_PX2 = 2.0


@njit(inline="always")
def systematic(c: FrameConstants, x: float, y: float, rise: float) -> Systematic:
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
def common_m2(c: FrameConstants, x: float, y: float) -> float:
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
def frames_m2(c: FrameConstants, x: float, y: float, stale_m: float) -> float:
    """V_frame of the measurement and V_frame + V_drift of the map, which are not in R and V."""
    rx = x + c.lever_x_m
    ry = y + c.lever_y_m
    return (c.frame_m2 + c.frame_rad2 * (rx * rx + ry * ry)) * (2.0 + c.drift_per_m * stale_m)


@njit(inline="always")
def shared_m2(known: Known, m: Measurement, c: FrameConstants) -> float:
    """Covariance of the errors of map and measurement: what frames from one place have alike.

    Of a frame's own noise it is `fixed_share`; all of it where one image row grazes the cell, and
    noise decides which of its readings fall in. Of the map such frames made `repeats / frames`, at
    most.
    """
    one_row = min(_SPARSE_PX2 / (m.pixels * m.pixels), 1.0)
    alike = m.own_m2 * max(one_row, c.fixed_share)
    return min(alike * min(c.repeats / max(known.frames, 1.0), 1.0), known.variance_m2)
