"""Kinematics of a skid-steered vehicle: wheel speeds to twist and back.

A skid-steered vehicle turns by dragging its wheels sideways, so it turns less than its geometric
track B says. On flat ground this is the same as a differential drive with a wider, effective
track B_e, where B_e / B is about 1.4 to 1.5 and depends on the surface (Mandow et al. 2007,
"Experimental kinematics for wheeled skid-steer mobile robots": the lateral coordinate of the
instantaneous centres of rotation is B_e / 2).

    v = (v_right + v_left) / 2          w = (v_right - v_left) / B_e

Axes: x forward, z up, w counter-clockwise. Speeds are those of the wheel rims.
"""

from __future__ import annotations

import math


def twist(left_m_s: float, right_m_s: float, effective_track_m: float) -> tuple[float, float]:
    """Return (forward speed in m/s, yaw rate in rad/s) of the rim speeds of both sides."""
    return (right_m_s + left_m_s) / 2.0, (right_m_s - left_m_s) / effective_track_m


def rim_speeds(
    speed_m_s: float, yaw_rate_rad_s: float, effective_track_m: float
) -> tuple[float, float]:
    """Return the (left, right) rim speeds in m/s of a twist: the inverse of `twist`."""
    half = yaw_rate_rad_s * effective_track_m / 2.0
    return speed_m_s - half, speed_m_s + half


def twist_sigmas(
    yaw_rate_rad_s: float, rim_sigma_m_s: float, effective_track_m: float, track_sigma_ratio: float
) -> tuple[float, float]:
    """Return the standard deviations of (speed in m/s, yaw rate in rad/s).

    With independent errors s of each side and a relative error k of the effective track, to
    first order:  var v = s^2 / 2,  var w = 2 s^2 / B_e^2 + (k w)^2.
    """
    speed_sigma = rim_sigma_m_s / math.sqrt(2.0)
    yaw_sigma = math.hypot(
        math.sqrt(2.0) * rim_sigma_m_s / effective_track_m, track_sigma_ratio * yaw_rate_rad_s
    )
    return speed_sigma, yaw_sigma
