"""The poses of a run for other programs: /odom and /tf in a recording of their own."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from mcap.writer import Writer
from rosbags.typesys.stores import ros2_humble as ros
from scipy.spatial.transform import Rotation

from acquisition.messages import ros_fields as fields
from acquisition.messages.codec import schema_text, typestore
from acquisition.messages.frames import WORLD_FRAME
from drivers.samples import Float64Array
from mapping.errors import MappingError
from mapping.files import write_whole
from mapping.geometry import UncertainPose
from mapping.judging.trajectory import write_path

_ODOMETRY, _TRANSFORMS = "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"


def write_trajectory(path: Path, poses: Sequence[UncertainPose], body_frame: str) -> None:
    """Write poses: `.mcap` with /odom and /tf, `.nc` with covariances, else a TUM file.

    Raises:
        MappingError: there are no poses, a time is no ROS time, or the file cannot be written.
    """
    if path.suffix != ".mcap":
        write_path(path, poses)
        return
    if not poses:
        raise MappingError(f"no pose was found; nothing to write to {path}")
    try:
        write_whole(path, _recording(poses, body_frame))
    except ValueError as error:
        raise MappingError(f"cannot write {path}: {error}") from error


def _recording(poses: Sequence[UncertainPose], body_frame: str) -> bytes:
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start("ros2", "terravibe")
    channels = {}
    for topic, ros_type in (("/odom", _ODOMETRY), ("/tf", _TRANSFORMS)):
        schema = writer.register_schema(ros_type, "ros2msg", schema_text(ros_type).encode())
        channels[topic] = writer.register_channel(topic, "cdr", schema)
    for sequence, pose in enumerate(poses):
        quat = Rotation.from_matrix(pose.transform.rotation).as_quat(
            canonical=True, scalar_first=True
        )
        for topic, message, ros_type in (
            ("/odom", _odometry(pose, quat, body_frame), _ODOMETRY),
            ("/tf", _transform(pose, quat, body_frame), _TRANSFORMS),
        ):
            cdr = typestore().serialize_cdr(message, ros_type, little_endian=True)
            writer.add_message(channels[topic], pose.t_ns, bytes(cdr), pose.t_ns, sequence)
    writer.finish()
    return stream.getvalue()


def _odometry(
    pose: UncertainPose, quat_wxyz: Float64Array, body_frame: str
) -> ros.nav_msgs__msg__Odometry:
    """Return the pose; -1 in element 0 of the twist's covariance says that it is not known."""
    unknown = np.zeros(36)
    unknown[0] = -1.0
    still = ros.geometry_msgs__msg__Vector3(0.0, 0.0, 0.0)
    return ros.nav_msgs__msg__Odometry(
        fields.ros_header(pose.t_ns, WORLD_FRAME),
        body_frame,
        ros.geometry_msgs__msg__PoseWithCovariance(
            ros.geometry_msgs__msg__Pose(
                ros.geometry_msgs__msg__Point(*pose.transform.translation_m.tolist()),
                _quaternion(quat_wxyz),
            ),
            fields.finite("covariance", pose.covariance, (6, 6)).ravel(),
        ),
        ros.geometry_msgs__msg__TwistWithCovariance(
            ros.geometry_msgs__msg__Twist(still, still), unknown
        ),
    )


def _transform(
    pose: UncertainPose, quat_wxyz: Float64Array, body_frame: str
) -> ros.tf2_msgs__msg__TFMessage:
    return ros.tf2_msgs__msg__TFMessage(
        [
            ros.geometry_msgs__msg__TransformStamped(
                fields.ros_header(pose.t_ns, WORLD_FRAME),
                body_frame,
                ros.geometry_msgs__msg__Transform(
                    fields.ros_vector("position", pose.transform.translation_m),
                    _quaternion(quat_wxyz),
                ),
            )
        ]
    )


def _quaternion(quat_wxyz: Float64Array) -> ros.geometry_msgs__msg__Quaternion:
    w, x, y, z = quat_wxyz.tolist()
    return ros.geometry_msgs__msg__Quaternion(x, y, z, w)
