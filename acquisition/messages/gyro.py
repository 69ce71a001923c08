"""Yaw rates as sensor_msgs/msg/Imu and GyroRaw; reasons of failure as ValueError."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from rosbags.typesys.stores import ros2_humble as ros

from acquisition.messages import ros_fields as fields
from acquisition.messages.cdr_layout import Parts, layout
from acquisition.messages.companions import Companion
from acquisition.messages.frames import GYRO_FRAME
from acquisition.messages.ros_types import IMU_TYPE, RosMessage
from drivers.samples import YawRateSample

RAW_TYPE = "terravibe_msgs/msg/GyroRaw"

# An orientation that is not measured; the rates about x and y, which are not either.
_BEFORE_RATE = (0.0, 0.0, 0.0, 1.0, *fields.NOT_MEASURED, 0.0, 0.0)
# The covariance of the rate, all 0: not known. Then an acceleration that is not measured.
_BEHIND_RATE = (*(0.0,) * 9, 0.0, 0.0, 0.0, *fields.NOT_MEASURED)


def encode_yaw_rate(sample: YawRateSample, t_ns: int, _sequence: int) -> Parts:
    """Return an Imu message whose z axis is the sensing axis; x and y are 0, not measured."""
    rate_rad_s = fields.finite_number("rate", sample.rate_rad_s)
    return _imu_layout()(t_ns, rate_rad_s)


@cache
def _imu_layout() -> Callable[..., Parts]:
    return layout(IMU_TYPE, GYRO_FRAME, _BEFORE_RATE, _BEHIND_RATE)


def decode_yaw_rate(imu: ros.sensor_msgs__msg__Imu, sequence: int) -> YawRateSample:
    """Return the rate about z; counts and temperature are in the companion, if there is one."""
    fields.require_measured("angular velocity", imu.angular_velocity_covariance)
    rate_rad_s = fields.finite_number("rate", imu.angular_velocity.z)
    return YawRateSample(fields.stamp_ns(imu.header), rate_rad_s, None, None, sequence)


def encode_gyro_raw(sample: YawRateSample, t_ns: int, _sequence: int) -> Parts:
    """Return what the Imu message has no room for."""
    return layout(RAW_TYPE, GYRO_FRAME)(
        t_ns,
        *fields.flagged_integer("raw counts", sample.raw_counts, -(2**31), 2**31 - 1),
        *fields.flagged("temperature", sample.temperature_c),
    )


def decode_gyro_raw(message: RosMessage, _sequence: int) -> Companion:
    """Return counts and temperature for the rate with the same stamp."""
    return Companion(
        fields.stamp_ns(message.header),
        YawRateSample,
        {
            "raw_counts": message.raw_counts if message.has_raw_counts else None,
            "temperature_c": fields.unflagged(
                "temperature", message.has_temperature, message.temperature_c
            ),
        },
    )
