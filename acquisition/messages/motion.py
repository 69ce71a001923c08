"""Poses, accelerations and static transforms as ROS messages; reasons of failure as ValueError."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from rosbags.typesys.stores import ros2_humble as ros

from acquisition.messages import ros_fields as fields
from acquisition.messages.cdr_layout import Parts, layout
from acquisition.messages.frames import (
    ACCELEROMETER_FRAME,
    WORLD_FRAME,
    StaticTransform,
    StaticTransforms,
)
from acquisition.messages.ros_types import IMU_TYPE
from drivers.samples import AccelerationSample, PoseSample

POSE_TYPE = "geometry_msgs/msg/PoseWithCovarianceStamped"

# Neither orientation nor rotation is measured.
_BEFORE_ACCELERATION = (
    0.0,
    0.0,
    0.0,
    1.0,
    *fields.NOT_MEASURED,
    0.0,
    0.0,
    0.0,
    *fields.NOT_MEASURED,
)
_UNKNOWN_COVARIANCE = (0.0,) * 9


def encode_pose(pose: PoseSample, t_ns: int, _sequence: int) -> Parts:
    """Return the pose; ROS has the covariance row by row and in the same order."""
    return layout(POSE_TYPE, WORLD_FRAME)(
        t_ns,
        *fields.three("position", pose.position_m),
        *fields.xyzw(pose.quat_wxyz),
        *fields.numbers("covariance", pose.covariance, (6, 6)),
    )


def decode_pose(
    message: ros.geometry_msgs__msg__PoseWithCovarianceStamped, sequence: int
) -> PoseSample:
    """Return the pose of the tracked body."""
    return PoseSample(
        fields.stamp_ns(message.header),
        fields.vector("position", message.pose.pose.position),
        fields.quaternion(message.pose.pose.orientation),
        fields.finite("covariance", message.pose.covariance.reshape(6, 6), (6, 6)),
        sequence,
    )


def encode_acceleration(sample: AccelerationSample, t_ns: int, _sequence: int) -> Parts:
    """Return an Imu message that measured nothing but the acceleration."""
    return _imu_layout()(t_ns, *fields.three("acceleration", sample.acceleration_m_s2))


@cache
def _imu_layout() -> Callable[..., Parts]:
    return layout(IMU_TYPE, ACCELEROMETER_FRAME, _BEFORE_ACCELERATION, _UNKNOWN_COVARIANCE)


def decode_acceleration(imu: ros.sensor_msgs__msg__Imu, sequence: int) -> AccelerationSample:
    """Return the acceleration of an Imu message."""
    fields.require_measured("acceleration", imu.linear_acceleration_covariance)
    return AccelerationSample(
        fields.stamp_ns(imu.header),
        fields.vector("acceleration", imu.linear_acceleration),
        sequence,
    )


def encode_transforms(
    message: StaticTransforms, t_ns: int, _sequence: int
) -> ros.tf2_msgs__msg__TFMessage:
    """Return the transforms, all with the same stamp."""
    return ros.tf2_msgs__msg__TFMessage(
        [
            ros.geometry_msgs__msg__TransformStamped(
                fields.ros_header(t_ns, transform.parent_frame),
                transform.child_frame,
                ros.geometry_msgs__msg__Transform(
                    fields.ros_vector("position", transform.position_m),
                    ros.geometry_msgs__msg__Quaternion(*fields.xyzw(transform.quat_wxyz)),
                ),
            )
            for transform in message.transforms
        ]
    )


def decode_transforms(message: ros.tf2_msgs__msg__TFMessage, _sequence: int) -> StaticTransforms:
    """Return the transforms, with the latest of their stamps."""
    transforms = tuple(
        StaticTransform(
            stamped.header.frame_id,
            stamped.child_frame_id,
            fields.vector("position", stamped.transform.translation),
            fields.quaternion(stamped.transform.rotation),
        )
        for stamped in message.transforms
    )
    stamps = [fields.stamp_ns(stamped.header) for stamped in message.transforms]
    return StaticTransforms(max(stamps, default=0), transforms)
