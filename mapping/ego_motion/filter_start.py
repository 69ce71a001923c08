"""What the filter begins with: the constants of its kernel, and the first state."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from mapping.ego_motion.filter_types import FilterConstants, States
from mapping.ego_motion.settings import EgoMotionSettings
from mapping.ego_motion.states import (
    ACCELERATION,
    FORCE_ERROR,
    GYRO_BIAS,
    PITCH_BIAS,
    PITCH_ERROR,
    ROLL_BIAS,
    ROLL_ERROR,
    SIZE,
    SLIP,
    SPEED,
    TICK_PITCH,
    TICK_PITCH_VARIANCE,
    TICK_ROLL,
    TICK_ROLL_VARIANCE,
    TICK_SLIP_VARIANCE,
    TRACK_ERROR,
    TURN,
    VIBRATION_SCALE,
    WHEEL_SCALE,
    YAW,
    X,
    Y,
    Z,
)
from mapping.geometry import Float64Array


def begin(
    first: States,
    settings: EgoMotionSettings,
    t_ns: int,
    start: Float64Array,
    start_covariance: Float64Array,
) -> None:
    """Fill in the first state.

    Args:
        first: room for one state, all zeros.
        settings: of ego-motion.
        t_ns: time of the first tick.
        start: (6,) x, y, z, roll, pitch, yaw there.
        start_covariance: (6, 6) of the same.
    """
    first.t_ns[0] = t_ns
    first.x[0, [X, Y, Z, YAW]] = start[[0, 1, 2, 5]]
    first.p[0] = _first_covariance(settings, start_covariance)
    first.phi[0] = np.eye(SIZE)
    first.held[0, [TICK_ROLL, TICK_PITCH]] = start[[3, 4]]
    first.held[0, [TICK_ROLL_VARIANCE, TICK_PITCH_VARIANCE]] = settings.tilt_lost_rad**2
    first.held[0, TICK_SLIP_VARIANCE] = settings.slip**2


def _first_covariance(settings: EgoMotionSettings, start: Float64Array) -> Float64Array:
    """Return the covariance of the first state; tilt is what the levelling finds."""
    p = np.zeros((SIZE, SIZE))
    planar = [0, 1, 2, 5]
    p[np.ix_([X, Y, Z, YAW], [X, Y, Z, YAW])] = start[np.ix_(planar, planar)]
    for state, sigma in {
        TURN: settings.turn_sigma_rad_s,
        SPEED: settings.speed_sigma_m_s,
        GYRO_BIAS: settings.gyro_bias_rad_s,
        WHEEL_SCALE: settings.wheel_scale,
        SLIP: settings.slip,
        ROLL_ERROR: settings.tilt_lost_rad,
        PITCH_ERROR: settings.tilt_lost_rad,
        ROLL_BIAS: settings.levelling_bias_rad,
        PITCH_BIAS: settings.levelling_bias_rad,
        TRACK_ERROR: settings.track_sigma,
        VIBRATION_SCALE: settings.vibration_scale,
        FORCE_ERROR: 1.0,
        ACCELERATION: settings.acceleration_m_s2,
    }.items():
        p[state, state] = sigma**2
    return p


def filter_constants(settings: EgoMotionSettings) -> FilterConstants:
    """Return what the kernel needs of the settings."""
    turn_walk = settings.turn_walk_rad_s2_per_sqrt_hz
    return FilterConstants(
        tick_s=settings.tick_s,
        levelling_time_s=settings.levelling_time_s,
        slip_time_s=settings.slip_time_s,
        slip_surprise=settings.slip_surprise,
        lateral_slip_ratio=settings.lateral_slip_ratio,
        vertical_walk_ratio=settings.vertical_walk_ratio,
        lateral_slip_time_s=settings.lateral_slip_time_s,
        acceleration_m_s2=settings.acceleration_m_s2,
        acceleration_time_s=settings.acceleration_time_s,
        acceleration_walk=2.0 * settings.acceleration_time_s * settings.acceleration_m_s2**2,
        speed_sigma_m_s=settings.speed_sigma_m_s,
        turn_walk=turn_walk,
        turn_sigma_rad_s=settings.turn_sigma_rad_s,
        turn_time_s=2.0 * settings.turn_sigma_rad_s**2 / turn_walk**2,
        gyro_bias_walk=settings.gyro_bias_walk_rad_s_per_sqrt_s,
        force_walk=settings.gravity_m_s2 * settings.ground_walk_rad_per_sqrt_s,
        wheel_scale_walk=settings.wheel_scale_walk_per_sqrt_s,
        zero_speed_m_s=settings.zero_speed_m_s,
        zero_speed_alone_m_s=settings.zero_speed_alone_m_s,
        zero_rate_rad_s=settings.zero_rate_rad_s,
        gate_nis=settings.gate_sigma**2,
        pose_gate_nis=float(chi2.isf(settings.pose_gate_probability, 6)),
    )
