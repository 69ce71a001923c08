"""What goes into the filter's kernel and comes out of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Float64Array = NDArray[np.float64]
Int64Array = NDArray[np.int64]


class FilterConstants(NamedTuple):
    """The settings that the kernel needs; units as in `EgoMotionSettings`."""

    tick_s: float
    levelling_time_s: float
    slip_time_s: float
    slip_surprise: float
    lateral_slip_ratio: float
    vertical_walk_ratio: float
    lateral_slip_time_s: float
    acceleration_m_s2: float
    acceleration_time_s: float
    acceleration_walk: float
    speed_sigma_m_s: float
    turn_walk: float
    turn_time_s: float
    turn_sigma_rad_s: float
    gyro_bias_walk: float
    wheel_scale_walk: float
    force_walk: float
    zero_speed_m_s: float
    zero_speed_alone_m_s: float
    zero_rate_rad_s: float
    gate_nis: float
    pose_gate_nis: float


class Rows(NamedTuple):
    """Measurements in order of time.

    t_ns (M,), kind (M,), values (M, COLUMNS); poses (K, 6) are x, y, z, roll, pitch, yaw in T,
    pose_covariances (K, 6, 6) theirs.
    """

    t_ns: Int64Array
    kind: Int64Array
    values: Float64Array
    poses: Float64Array
    pose_covariances: Float64Array


class States(NamedTuple):
    """States at ticks: t_ns (N,), x (N, SIZE), p and phi (N, SIZE, SIZE), held (N, COLUMNS)."""

    t_ns: Int64Array
    x: Float64Array
    p: Float64Array
    phi: Float64Array
    held: Float64Array
