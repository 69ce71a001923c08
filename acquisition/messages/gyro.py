"""Yaw rates as sensor_msgs/msg/Imu and GyroRaw; reasons of failure as ValueError."""

from __future__ import annotations

import numpy as np
from rosbags.typesys.stores import ros2_humble as ros

from acquisition.messages import ros_fields as fields
from acquisition.messages.companions import Companion
from acquisition.messages.frames import GYRO_FRAME
from acquisition.messages.ros_types import RosMessage, ros_class
from drivers.samples import YawRateSample

RAW_TYPE = "terravibe_msgs/msg/GyroRaw"


def encode_yaw_rate(sample: YawRateSample) -> ros.sensor_msgs__msg__Imu:
    """Return an Imu message whose z axis is the sensing axis; x and y are 0, not measured."""
    rate_rad_s = fields.finite_number("rate", sample.rate_rad_s)
    return ros.sensor_msgs__msg__Imu(
        fields.ros_header(sample.t_ns, GYRO_FRAME),
        ros.geometry_msgs__msg__Quaternion(0.0, 0.0, 0.0, 1.0),
        fields.not_measured(),
        ros.geometry_msgs__msg__Vector3(0.0, 0.0, rate_rad_s),
        np.zeros(9),  # all 0: the covariance is not known
        ros.geometry_msgs__msg__Vector3(0.0, 0.0, 0.0),
        fields.not_measured(),
    )


def decode_yaw_rate(imu: ros.sensor_msgs__msg__Imu, sequence: int) -> YawRateSample:
    """Return the rate about z; counts and temperature are in the companion, if there is one."""
    fields.require_measured("angular velocity", imu.angular_velocity_covariance)
    rate_rad_s = fields.finite_number("rate", imu.angular_velocity.z)
    return YawRateSample(fields.stamp_ns(imu.header), rate_rad_s, None, None, sequence)


def encode_gyro_raw(sample: YawRateSample) -> object:
    """Return what the Imu message has no room for."""
    return ros_class(RAW_TYPE)(
        fields.ros_header(sample.t_ns, GYRO_FRAME),
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
