"""A made-up drive of 20 s in three legs from stop to stop, and what its inertial sensors say."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from heapq import merge

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from drivers.samples import AccelerationSample, Sample, WheelTwistSample, YawRateSample

Float64Array = NDArray[np.float64]

_G = 9.80665
SECONDS = 20.0
_LEG_M = 3.1 / 3.0
_STARTS_S = (3.0, 8.6, 14.2)
SPEED_M_S, _RAMP_M_S2 = 0.3, 0.5
_TURNS_RAD_S = (0.0, 0.2, -0.2)
# Densities in m/s^2 and rad/s per root hertz; sigmas of the biases, of the wheels' scale and of
# their speed (m/s), drawn for every run or sample.
ACCELERATION_DENSITY, _ACCELERATION_BIAS = 0.05, 0.02
GYRO_DENSITY, _GYRO_BIAS = 5e-4, 0.01
WHEEL_SCALE, _WHEEL_SIGMA = 0.02, 0.005
# RMS per axis at SPEED_M_S, m/s^2, and its spread from run to run.
VIBRATION, VIBRATION_SPREAD = 1.0, 0.2


@dataclass(frozen=True, slots=True)
class Truth:
    """A drive every millisecond: speed, angles, position, specific force and rates in the body."""

    speed_m_s: Float64Array
    yaw_rad: Float64Array
    position_m: Float64Array
    force_m_s2: Float64Array
    body_rate_rad_s: Float64Array


def drive(bump_rad: float, random: np.random.Generator) -> Truth:
    """Return a drive over bumps of that amplitude, at places of their own in every run."""
    t = np.arange(0.0, SECONDS, 0.001)
    speed, turn = np.zeros(t.size), np.zeros(t.size)
    ramp_s = SPEED_M_S / _RAMP_M_S2
    leg_s = _LEG_M / SPEED_M_S + ramp_s
    for start_s, turn_rad_s in zip(_STARTS_S, _TURNS_RAD_S, strict=True):
        since = t - start_s
        share = np.clip(np.minimum(since, leg_s - since) / ramp_s, 0.0, 1.0)
        speed += SPEED_M_S * share
        turn += turn_rad_s * share
    way = np.cumsum(speed) * 0.001
    phases = random.uniform(0.0, 2.0 * math.pi, 2)
    roll = bump_rad * np.sin(2.0 * math.pi * way / 1.1 + phases[0])
    pitch = bump_rad * np.sin(2.0 * math.pi * way / 0.8 + phases[1])
    yaw = np.cumsum(turn) * 0.001
    body = Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll]))
    velocity = speed[:, np.newaxis] * body.as_matrix()[:, :, 0]
    acceleration = np.gradient(velocity, 0.001, axis=0)
    force = body.inv().apply(acceleration + np.array([0.0, 0.0, _G]))
    roll_rate, pitch_rate = np.gradient(roll, 0.001), np.gradient(pitch, 0.001)
    rate = np.column_stack(
        [
            roll_rate - turn * np.sin(pitch),
            pitch_rate * np.cos(roll) + turn * np.cos(pitch) * np.sin(roll),
            turn * np.cos(pitch) * np.cos(roll) - pitch_rate * np.sin(roll),
        ]
    )
    return Truth(speed, yaw, np.cumsum(velocity, axis=0) * 0.001, force, rate)


def measured_force(truth: Truth, random: np.random.Generator) -> Float64Array:
    """Return (N, 3) what the accelerometer says."""
    shape = truth.force_m_s2.shape
    noise = ACCELERATION_DENSITY * math.sqrt(500.0) * random.standard_normal(shape)
    level = VIBRATION * (1.0 + VIBRATION_SPREAD * random.standard_normal())
    shaking = level * truth.speed_m_s[:, np.newaxis] / SPEED_M_S * random.standard_normal(shape)
    bias = _ACCELERATION_BIAS * random.standard_normal(3)
    return np.asarray(truth.force_m_s2 + noise + shaking + bias, np.float64)


def measured_rate(truth: Truth, random: np.random.Generator) -> Float64Array:
    """Return (M,) what the gyro says every 2.5 ms."""
    rate = np.interp(np.arange(0.0, SECONDS, 0.0025), *_curve(truth.body_rate_rad_s[:, 2]))
    noise = GYRO_DENSITY * math.sqrt(200.0) * random.standard_normal(rate.size)
    return np.asarray(rate + noise + _GYRO_BIAS * random.standard_normal(), np.float64)


def wheel_samples(truth: Truth, random: np.random.Generator) -> list[WheelTwistSample]:
    """Return twists every 20 ms."""
    t = np.arange(0.0, SECONDS, 0.02)
    scale = 1.0 + WHEEL_SCALE * random.standard_normal()
    speed = np.interp(t, *_curve(truth.speed_m_s))
    noise = _WHEEL_SIGMA * random.standard_normal(t.size) * (speed > 0.0)
    turn = np.interp(t, *_curve(truth.body_rate_rad_s[:, 2])) * (speed > 0.0)
    return [
        WheelTwistSample(stamp_ns(t[i]), v, w, _WHEEL_SIGMA, 0.05, None, None, i)
        for i, (v, w) in enumerate(
            zip((speed * scale + noise).tolist(), turn.tolist(), strict=True)
        )
    ]


def _curve(values: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return times (s) and values of a signal every millisecond."""
    return np.asarray(np.arange(values.size) * 0.001, np.float64), values


def stamp_ns(seconds: float) -> int:
    """Return the stamp of a time of the drive."""
    return 10**12 + round(seconds * 1e9)


def inertial_samples(force: Float64Array, rate: Float64Array) -> list[Sample]:
    """Return accelerations and yaw rates in order of time."""
    force.flags.writeable = False
    accelerations = [AccelerationSample(stamp_ns(i * 0.001), a, i) for i, a in enumerate(force)]
    rates = [
        YawRateSample(stamp_ns(i * 0.0025), w, None, None, i) for i, w in enumerate(rate.tolist())
    ]
    return in_order(accelerations, rates)


def in_order(*lists: Sequence[Sample]) -> list[Sample]:
    """Return the samples of several sensors by their stamps."""
    return list(merge(*lists, key=lambda sample: sample.t_ns))
