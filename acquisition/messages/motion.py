"""Poses, accelerations and static transforms as ROS messages; reasons of failure as ValueError."""

from __future__ import annotations

import numpy as np
from rosbags.typesys.stores import ros2_humble as ros

from acquisition.messages import ros_fields as fields
from acquisition.messages.frames import (
    ACCELEROMETER_FRAME,
    WORLD_FRAME,
    StaticTransform,
    StaticTransforms,
)
from drivers.samples import AccelerationSample, PoseSample, frozen_array

# sensor_msgs/msg/Imu: -1 in element 0 says that the sensor does not measure this part.
_NOT_MEASURED = frozen_array([-1.0, 0, 0, 0, 0, 0, 0, 0, 0], (9,))


def encode_pose(pose: PoseSample) -> ros.geometry_msgs__msg__PoseWithCovarianceStamped:
    """Return the pose; ROS has the covariance row by row and in the same order."""
    return ros.geometry_msgs__msg__PoseWithCovarianceStamped(
        fields.ros_header(pose.t_ns, WORLD_FRAME),
        ros.geometry_msgs__msg__PoseWithCovariance(
            ros.geometry_msgs__msg__Pose(
                fields.ros_point("position", pose.position_m),
                fields.ros_quaternion(pose.quat_wxyz),
            ),
            fields.finite("covariance", pose.covariance, (6, 6)).ravel(),
        ),
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


def encode_acceleration(sample: AccelerationSample) -> ros.sensor_msgs__msg__Imu:
    """Return an Imu message that measured nothing but the acceleration."""
    return ros.sensor_msgs__msg__Imu(
        fields.ros_header(sample.t_ns, ACCELEROMETER_FRAME),
        ros.geometry_msgs__msg__Quaternion(0.0, 0.0, 0.0, 1.0),
        fields.not_measured(),
        ros.geometry_msgs__msg__Vector3(0.0, 0.0, 0.0),
        fields.not_measured(),
        fields.ros_vector("acceleration", sample.acceleration_m_s2),
        linear_acceleration_covariance=np.zeros(9),
    )


def decode_acceleration(imu: ros.sensor_msgs__msg__Imu, sequence: int) -> AccelerationSample:
    """Return the acceleration of an Imu message."""
    fields.require_measured("acceleration", imu.linear_acceleration_covariance)
    return AccelerationSample(
        fields.stamp_ns(imu.header),
        fields.vector("acceleration", imu.linear_acceleration),
        sequence,
    )


def encode_transforms(message: StaticTransforms) -> ros.tf2_msgs__msg__TFMessage:
    """Return the transforms, all with the same stamp."""
    return ros.tf2_msgs__msg__TFMessage(
        [
            ros.geometry_msgs__msg__TransformStamped(
                fields.ros_header(message.t_ns, transform.parent_frame),
                transform.child_frame,
                ros.geometry_msgs__msg__Transform(
                    fields.ros_vector("position", transform.position_m),
                    fields.ros_quaternion(transform.quat_wxyz),
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
