"""Samples to and from ROS 2 messages (CDR), one table row for each topic.

A further sample type needs one function each way and one row in `MESSAGE_TYPES`.

What a ROS message has no room for travels elsewhere: the sequence number is the `sequence` of
the MCAP message record, and further fields are in a message of their own, a companion.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal, NamedTuple

from rosbags.serde import SerdeError

from acquisition.clocks.clock_sample import ClockSample
from acquisition.errors import StreamError
from acquisition.health.diagnostics import Diagnostics, decode_diagnostics, encode_diagnostics
from acquisition.messages.cdr_layout import Parts
from acquisition.messages.clock import CLOCK_TYPE, decode_clock, encode_clock
from acquisition.messages.companions import Companion
from acquisition.messages.depth import (
    CAMERA_TYPE,
    IMAGE_TYPE,
    TICKS_TYPE,
    CameraInfo,
    DepthImage,
    decode_camera,
    decode_depth,
    decode_ticks,
    encode_camera,
    encode_depth,
    encode_ticks,
)
from acquisition.messages.depth_rvl import (
    COMPRESSED_TYPE,
    RVL_TOPIC,
    decode_rvl,
    encode_rvl,
)
from acquisition.messages.frames import StaticTransforms
from acquisition.messages.gyro import (
    RAW_TYPE,
    decode_gyro_raw,
    decode_yaw_rate,
    encode_gyro_raw,
    encode_yaw_rate,
)
from acquisition.messages.motion import (
    POSE_TYPE,
    decode_acceleration,
    decode_pose,
    decode_transforms,
    encode_acceleration,
    encode_pose,
    encode_transforms,
)
from acquisition.messages.ros_fields import MAX_UINT32
from acquisition.messages.ros_types import IMU_TYPE
from acquisition.messages.ros_types import typestore as typestore
from acquisition.messages.vibration import VIBRATION_TYPE, decode_vibration, encode_vibration
from acquisition.messages.wheels import (
    CAN_TYPE,
    SPEEDS_TYPE,
    TWIST_TYPE,
    decode_can,
    decode_speeds,
    decode_twist,
    encode_can,
    encode_speeds,
    encode_twist,
)
from drivers.samples import (
    AccelerationSample,
    CanFrameSample,
    DepthFrame,
    PoseSample,
    Sample,
    VibrationSample,
    WheelTwistSample,
    YawRateSample,
)

Record = DepthImage | CameraInfo | Companion | Sample | StaticTransforms | ClockSample | Diagnostics
Recordable = Sample | StaticTransforms | ClockSample | Diagnostics
_UNNUMBERED = (StaticTransforms, Diagnostics)

# How depth frames are written: as pixels, or under a code of their own.
DepthFormat = Literal["raw", "rvl"]
IMAGE_TOPIC = "/depth/image"
_RAW = frozenset([RVL_TOPIC])


@dataclass(frozen=True, slots=True)
class MessageType:
    """One row of the table.

    Attributes:
        topic: where the message is published.
        ros_type: its ROS 2 type, "package/msg/Name".
        sample_type: the type of which `encode` makes this message.
        encode: sample, its time and its number in the stream to its CDR bytes, or to a ROS
            message object that is still to be serialised, or None where the sample has nothing
            to say here; ValueError with the reason.
        decode: ROS message object and sequence number to record; ValueError with the reason.
    """

    topic: str
    ros_type: str
    sample_type: type[Recordable]
    encode: Callable[[Any, int, int], object | None]
    decode: Callable[[Any, int], Record]


class EncodedMessage(NamedTuple):
    """A message ready to be written.

    Attributes:
        topic: where it is published.
        parts: its CDR bytes, in pieces that follow one another.
    """

    topic: str
    parts: Parts

    @property
    def cdr(self) -> bytes:
        """Its CDR bytes in one piece."""
        return b"".join(self.parts)


@cache
def schema_text(ros_type: str) -> str:
    """Return the ros2msg definition of a type, its parts included."""
    return typestore().generate_msgdef(ros_type, ros_version=2)[0]


def prepare(row: MessageType) -> None:
    """Make rosbags' code for a type now: milliseconds for which no first sample has to wait."""
    typestore().get_msgdef(row.ros_type)


def types_of(sample_types: Sequence[type[Recordable]]) -> list[MessageType]:
    """Return the rows that those sample types are written as, in the table's order."""
    return [row for row in MESSAGE_TYPES if row.sample_type in sample_types]


def left_out_by(depth_format: DepthFormat) -> frozenset[str]:
    """Return the topics that such a stream has not: a depth frame is written in one way only."""
    return frozenset([IMAGE_TOPIC]) if depth_format == "rvl" else _RAW


def rows_of(kind: type[Recordable]) -> Sequence[MessageType]:
    """Return the rows that one sample type is written as; the same as `types_of`, but quick."""
    rows = _BY_SAMPLE_TYPE.get(kind)
    if rows is None:
        rows = _BY_SAMPLE_TYPE[kind] = types_of([kind])
    return rows


def encode(sample: Recordable, left_out: Container[str] = _RAW) -> list[EncodedMessage]:
    """Return the messages that stand for one sample, in the order to be written.

    Args:
        sample: the sample.
        left_out: topics without which it is complete, by `left_out_by`.

    Raises:
        StreamError: the sample cannot be told as a message (time or sequence out of range,
            not finite, wrong shape); names the topic and the time.
    """
    number = 0 if isinstance(sample, _UNNUMBERED) else sample.sequence
    rows = [row for row in rows_of(type(sample)) if row.topic not in left_out]
    return [
        EncodedMessage(row.topic, parts)
        for row, parts in zip(rows, encode_rows(sample, rows, sample.t_ns, number), strict=True)
        if parts is not None
    ]


def encode_rows(
    sample: Recordable, rows: Sequence[MessageType], t_ns: int, sequence: int
) -> list[Parts | None]:
    """Return the CDR bytes of each of these messages, None for one that has nothing to say.

    Args:
        sample: the sample.
        rows: the messages that it is written as.
        t_ns: its time in the stream, which takes the place of its own.
        sequence: its number in the stream, likewise; 0 to 2^32-1.

    Raises:
        StreamError: as `encode`.
    """
    encoded: list[Parts | None] = []
    for row in rows:
        try:
            message = row.encode(sample, t_ns, sequence)
            if message is None or type(message) is tuple:
                encoded.append(message)
            else:
                encoded.append(_serialise(message, row))
        except (ValueError, struct.error) as error:
            raise StreamError(f"cannot write {row.topic} at {t_ns} ns: {error}") from error
    return encoded


def _serialise(message: object, row: MessageType) -> Parts:
    return (bytes(typestore().serialize_cdr(message, row.ros_type, little_endian=True)),)


def decode(row: MessageType, cdr: bytes, *, log_time_ns: int, sequence: int) -> Record:
    """Return what one message says; pure, and its arrays are read-only.

    Raises:
        StreamError: not such a message, or its values make no sense; names topic and log time.
    """
    try:
        return row.decode(typestore().deserialize_cdr(cdr, row.ros_type), sequence)
    except (SerdeError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise StreamError(f"bad message on {row.topic} at {log_time_ns} ns: {reason}") from error


def checked_sequence(sample: Recordable, sequence: int | None = None) -> int:
    """Return the number under which a sample is written; 0 for what has none.

    Args:
        sample: the sample.
        sequence: its number in the stream; without one, its own.

    Raises:
        StreamError: it does not fit the 32 bits that the stream has for it.
    """
    if sequence is None:
        sequence = 0 if isinstance(sample, _UNNUMBERED) else sample.sequence
    if not 0 <= sequence <= MAX_UINT32:  # the MCAP message record holds a uint32
        raise StreamError(f"{type(sample).__name__} has sequence {sequence}; expected 0 to 2^32-1")
    return sequence


# Cameras and companions come before the main message that they belong to.
MESSAGE_TYPES: tuple[MessageType, ...] = (
    MessageType(
        "/tf_static",
        "tf2_msgs/msg/TFMessage",
        StaticTransforms,
        encode_transforms,
        decode_transforms,
    ),
    MessageType("/depth/camera_info", CAMERA_TYPE, DepthFrame, encode_camera, decode_camera),
    MessageType("/depth/ticks", TICKS_TYPE, DepthFrame, encode_ticks, decode_ticks),
    MessageType(RVL_TOPIC, COMPRESSED_TYPE, DepthFrame, encode_rvl, decode_rvl),
    MessageType(IMAGE_TOPIC, IMAGE_TYPE, DepthFrame, encode_depth, decode_depth),
    MessageType("/mocap/pose", POSE_TYPE, PoseSample, encode_pose, decode_pose),
    MessageType(
        "/acceleration",
        IMU_TYPE,
        AccelerationSample,
        encode_acceleration,
        decode_acceleration,
    ),
    MessageType("/vibration", VIBRATION_TYPE, VibrationSample, encode_vibration, decode_vibration),
    MessageType("/gyro/raw", RAW_TYPE, YawRateSample, encode_gyro_raw, decode_gyro_raw),
    MessageType("/gyro", IMU_TYPE, YawRateSample, encode_yaw_rate, decode_yaw_rate),
    MessageType("/can", CAN_TYPE, CanFrameSample, encode_can, decode_can),
    MessageType("/wheels/speeds", SPEEDS_TYPE, WheelTwistSample, encode_speeds, decode_speeds),
    MessageType("/wheels", TWIST_TYPE, WheelTwistSample, encode_twist, decode_twist),
    MessageType("/clock", CLOCK_TYPE, ClockSample, encode_clock, decode_clock),
    MessageType(
        "/diagnostics",
        "diagnostic_msgs/msg/DiagnosticArray",
        Diagnostics,
        encode_diagnostics,
        decode_diagnostics,
    ),
)

_BY_SAMPLE_TYPE: dict[type[Recordable], list[MessageType]] = {}
_BY_TOPIC_AND_TYPE = {(row.topic, row.ros_type): row for row in MESSAGE_TYPES}


def find(topic: str, ros_type: str) -> MessageType | None:
    """Return the row of a topic that carries the expected type, or None."""
    return _BY_TOPIC_AND_TYPE.get((topic, ros_type))
