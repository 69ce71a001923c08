"""Coordinate frames of a recording: their names, and the fixed transforms between them."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.samples import Float64Array, frozen_array

# The fixed frame in which poses are given; its z axis points up.
WORLD_FRAME = "world"
# The body that /mocap/pose tracks: the marker cluster, not the rover.
MOCAP_BODY_FRAME = "mocap_body"
# The rover (REP 105): x forward, y left, z up.
BASE_FRAME = "base_link"
# The depth camera (REP 103): x right, y down, z forward.
DEPTH_OPTICAL_FRAME = "depth_optical_frame"
# The chip's own axes of the accelerometer.
ACCELEROMETER_FRAME = "accelerometer"
# The sensor's own axes of the vibration sensor.
VIBRATION_FRAME = "vibration_sensor"
# The gyro, with z along the one axis that it senses, right-handed.
GYRO_FRAME = "gyro"
# The middle between the wheels: x forward, z up.
WHEELS_FRAME = "wheels"

# What may be mounted somewhere.
MOUNTED_FRAMES = (
    DEPTH_OPTICAL_FRAME,
    MOCAP_BODY_FRAME,
    ACCELEROMETER_FRAME,
    VIBRATION_FRAME,
    GYRO_FRAME,
    WHEELS_FRAME,
)


@dataclass(frozen=True, slots=True)
class StaticTransform:
    """Where the child frame sits in the parent frame, for the whole recording.

    A point given in the child frame is p_parent = R(quat_wxyz) p_child + position_m.

    Attributes:
        parent_frame: name of the frame in which the pose is given.
        child_frame: name of the frame whose pose it is.
        position_m: (3,) origin of the child in the parent, metres.
        quat_wxyz: (4,) unit quaternion, child axes to parent axes.
    """

    parent_frame: str
    child_frame: str
    position_m: Float64Array
    quat_wxyz: Float64Array


@dataclass(frozen=True, slots=True)
class StaticTransforms:
    """The fixed transforms that one program published together.

    Attributes:
        t_ns: time at which they were published; they hold for the whole recording.
        transforms: the transforms, in the order of the message.
    """

    t_ns: int
    transforms: tuple[StaticTransform, ...]


def camera_is_tracked_body() -> StaticTransform:
    """Return the mount of recordings whose poses are those of the depth camera itself."""
    position = frozen_array((0.0, 0.0, 0.0), (3,))
    no_rotation = frozen_array((1.0, 0.0, 0.0, 0.0), (4,))
    return StaticTransform(MOCAP_BODY_FRAME, DEPTH_OPTICAL_FRAME, position, no_rotation)
