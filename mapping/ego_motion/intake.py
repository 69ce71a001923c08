"""What samples say about motion, in base_link's axes and at the middle of what was measured."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from acquisition.messages.codec import Recordable
from acquisition.messages.frames import (
    ACCELEROMETER_FRAME,
    BASE_FRAME,
    GYRO_FRAME,
    VIBRATION_FRAME,
    WHEELS_FRAME,
)
from drivers.samples import AccelerationSample, VibrationSample, WheelTwistSample, YawRateSample
from drivers.vibration.acceleration import acceleration_m_s2
from mapping.ego_motion.front_end import FrontEnd
from mapping.ego_motion.sample_queue import SampleQueue
from mapping.ego_motion.settings import EgoMotionSettings
from mapping.geometry import Float64Array
from mapping.mounts import MountTree


class Reading(NamedTuple):
    """One measurement: the queue that it belongs to, its time and numbers, and its name."""

    queue: SampleQueue
    t_ns: int
    values: tuple[float, ...]
    what: str


class Intake:
    """Makes readings of samples.

    Args:
        settings: of ego-motion.
        mounts: where the sensors are; one that is not there has base_link's axes.
        front: whose queues the readings belong to.
    """

    def __init__(self, settings: EgoMotionSettings, mounts: MountTree, front: FrontEnd) -> None:
        self._mounts = mounts
        self._front = front
        self._axes: dict[str, Float64Array] = {}
        self._gyro_zero_rad_s, self._gyro_scale = settings.gyro_zero_rad_s, settings.gyro_scale
        self._force_zero, self._force_turn = _force_correction(settings)
        self._metres_per_cycle = settings.vibration_m_per_cycle
        self._gyro_ns = round(settings.gyro_delay_s * 1e9)
        self._wheels_ns = round(settings.wheels_delay_s * 1e9)
        self._force_ns = round(settings.acceleration_delay_s * 1e9)
        self._vibration_ns = round(settings.vibration_delay_s * 1e9)

    def forget_mounts(self) -> None:
        """Look mounts up again: there are new ones."""
        self._axes.clear()

    def reading(self, sample: Recordable) -> Reading | None:
        """Return what a sample says about motion; None when that is nothing."""
        if isinstance(sample, AccelerationSample):
            return self._force(sample.t_ns, sample.acceleration_m_s2, ACCELEROMETER_FRAME)
        if isinstance(sample, YawRateSample):
            rate = self._gyro_scale * (sample.rate_rad_s - self._gyro_zero_rad_s)
            rate /= float(self._to_base(GYRO_FRAME)[2, 2])
            return Reading(self._front.gyro, sample.t_ns - self._gyro_ns, (rate,), "a yaw rate")
        if isinstance(sample, WheelTwistSample):
            return self._twist(sample)
        if isinstance(sample, VibrationSample):
            return self._vibration(sample)
        return None

    def _force(self, t_ns: int, force: Float64Array, frame: str) -> Reading:
        if self._force_turn is not None:
            force = self._force_turn @ (force - self._force_zero)
        x, y, z = (self._to_base(frame) @ force).tolist()
        return Reading(self._front.force, t_ns - self._force_ns, (x, y, z), "an acceleration")

    def _twist(self, sample: WheelTwistSample) -> Reading:
        forward = math.copysign(1.0, float(self._to_base(WHEELS_FRAME)[0, 0]))
        values = (
            forward * sample.speed_m_s,
            sample.speed_sigma_m_s,
            sample.yaw_rate_rad_s,
            sample.yaw_rate_sigma_rad_s,
        )
        return Reading(self._front.wheels, sample.t_ns - self._wheels_ns, values, "a wheel twist")

    def _vibration(self, sample: VibrationSample) -> Reading | None:
        if sample.statistic == "instantaneous":
            if sample.quantity != "acceleration":
                return None
            return self._force(sample.t_ns, sample.amplitude, VIBRATION_FRAME)
        peak = acceleration_m_s2(
            sample.amplitude, sample.frequency_hz, sample.quantity, sample.statistic
        )
        if np.isnan(peak).all():
            return None  # nothing but codes for "no value"
        rms = math.sqrt(0.5 * float(np.nansum(peak**2)))
        speed = float(sample.frequency_hz[int(np.nanargmax(peak))]) * self._metres_per_cycle
        t_ns = sample.t_ns - self._vibration_ns
        return Reading(self._front.vibration, t_ns, (rms, speed), "a vibration")

    def _to_base(self, frame: str) -> Float64Array:
        """Return C_R_sensor."""
        if frame not in self._axes:
            known = self._mounts.connects(BASE_FRAME, frame)
            self._axes[frame] = (
                self._mounts.lookup(BASE_FRAME, frame).rotation if known else np.eye(3)
            )
        return self._axes[frame]


def _force_correction(s: EgoMotionSettings) -> tuple[Float64Array, Float64Array | None]:
    """Return the zero and T diag(1/scale) of a calibrated accelerometer; None = as it is."""
    zero = np.array([s.force_zero_x_m_s2, s.force_zero_y_m_s2, s.force_zero_z_m_s2])
    turn = np.eye(3)
    turn[0, 1], turn[0, 2] = -s.force_crooked_xy_rad, -s.force_crooked_xz_rad
    turn[1, 2] = -s.force_crooked_yz_rad
    turn = turn / np.array([s.force_scale_x, s.force_scale_y, s.force_scale_z])
    is_plain = not zero.any() and np.array_equal(turn, np.eye(3))
    return zero, None if is_plain else turn
