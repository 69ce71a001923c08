"""Messages laid out in one step are, byte for byte, what rosbags serialises."""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from rosbags.typesys.stores import ros2_humble as ros

from acquisition.errors import StreamError
from acquisition.messages import codec, ros_fields
from acquisition.messages.cdr_layout import layout, restamped
from acquisition.messages.depth import CAMERA_TYPE
from acquisition.messages.ros_types import IMU_TYPE, ros_class, typestore
from acquisition.messages.vibration import VIBRATION_TYPE
from acquisition.messages.wheels import CAN_TYPE, SPEEDS_TYPE
from drivers.samples import CameraIntrinsics, DepthFrame
from tests.fakes.device_samples import can_frame, one_of_each, with_ticks
from tests.fakes.recordings import START_NS

times_ns = st.integers(0, 2**31 * 10**9 - 1)
floats = st.floats(width=64)
uint64s = st.integers(0, 2**64 - 1)
uint32s = st.integers(0, 2**32 - 1)
bytes8 = st.integers(0, 255)


def by_rosbags(message: object, ros_type: str) -> bytes:
    return bytes(typestore().serialize_cdr(message, ros_type, little_endian=True))


@given(
    times_ns,
    st.text(max_size=12),
    st.lists(floats, min_size=37, max_size=37),
    st.integers(0, 37),
    st.integers(0, 37),
)
def test_a_message_of_numbers(
    t_ns: int, frame: str, values: list[float], one: int, other: int
) -> None:
    arrays = np.array(values)
    message = ros.sensor_msgs__msg__Imu(
        ros_fields.ros_header(t_ns, frame),
        ros.geometry_msgs__msg__Quaternion(*values[:4]),
        arrays[4:13],
        ros.geometry_msgs__msg__Vector3(*values[13:16]),
        arrays[16:25],
        ros.geometry_msgs__msg__Vector3(*values[25:28]),
        arrays[28:37],
    )
    (laid,) = layout(IMU_TYPE, frame)(t_ns, *values)
    assert laid == by_rosbags(message, IMU_TYPE)
    start, end = min(one, other), max(one, other)
    # Not from the cache, to which 0.0 and -0.0 are the same.
    make = layout.__wrapped__
    some_constant = make(IMU_TYPE, frame, tuple(values[:start]), tuple(values[end:]))
    assert some_constant(t_ns, *values[start:end]) == (laid,)


@given(
    times_ns,
    st.text(max_size=12),
    st.tuples(st.integers(-(2**63), 2**63 - 1), uint32s, *[floats] * 6, bytes8, bytes8),
    st.tuples(st.booleans(), floats, st.booleans(), uint64s),
)
def test_a_message_of_many_types(t_ns: int, frame: str, first: Any, last: Any) -> None:
    receive_ns, sequence, *axes, quantity, statistic = first
    message = ros_class(VIBRATION_TYPE)(
        ros_fields.ros_header(t_ns, frame),
        receive_ns,
        sequence,
        np.array(axes[:3]),
        np.array(axes[3:]),
        quantity,
        statistic,
        *last,
    )
    (laid,) = layout(VIBRATION_TYPE, frame)(t_ns, *first, *last)
    assert laid == by_rosbags(message, VIBRATION_TYPE)


@given(times_ns, st.text(max_size=12), uint32s, st.binary(max_size=8))
def test_a_message_with_bytes(t_ns: int, frame: str, number: int, data: bytes) -> None:
    flags = (True, False, True, 8)
    header = ros_fields.ros_header(t_ns, frame)
    array = np.frombuffer(data.ljust(8, b"\0"), dtype=np.uint8)
    message = ros_class(CAN_TYPE)(header, number, *flags, array)
    (laid,) = layout(CAN_TYPE, frame)(t_ns, number, *flags, data)
    assert laid == by_rosbags(message, CAN_TYPE)


@pytest.mark.parametrize("sample", [*one_of_each(3, START_NS + 7), with_ticks(3)])
def test_every_message_of_a_device_is_as_rosbags_would_have_it(sample: Any) -> None:
    for message in codec.encode(sample):
        row = next(row for row in codec.MESSAGE_TYPES if row.topic == message.topic)
        again = typestore().deserialize_cdr(message.cdr, row.ros_type)
        assert message.cdr == by_rosbags(again, row.ros_type)


@given(times_ns, hnp.arrays(np.uint16, hnp.array_shapes(min_dims=2, max_dims=2, max_side=7)))
def test_an_image_refers_to_pixels_that_cannot_change_and_copies_others(
    t_ns: int, depth_mm: Any
) -> None:
    height, width = depth_mm.shape
    camera = CameraIntrinsics(width, height, 5.0, 5.0, 1.0, 1.0)
    changing = DepthFrame(t_ns, depth_mm, camera, 0)
    *_, copied = codec.encode(changing)
    depth_mm = depth_mm.copy()
    depth_mm.flags.writeable = False
    *_, message = codec.encode(replace(changing, depth_mm=depth_mm))
    image = typestore().deserialize_cdr(message.cdr, "sensor_msgs/msg/Image")
    assert copied.cdr == message.cdr == by_rosbags(image, "sensor_msgs/msg/Image")
    assert np.shares_memory(np.asarray(message.parts[1]), depth_mm)
    assert not np.shares_memory(np.asarray(copied.parts[1]), changing.depth_mm)


@given(times_ns)
def test_another_stamp_changes_nothing_else(t_ns: int) -> None:
    info = next(m for m in codec.encode(with_ticks(3)) if m.topic == "/depth/camera_info")
    message: Any = typestore().deserialize_cdr(info.cdr, CAMERA_TYPE)
    message.header = ros_fields.ros_header(t_ns, message.header.frame_id)
    assert restamped(info.cdr, t_ns) == by_rosbags(message, CAMERA_TYPE)


@pytest.mark.parametrize(
    ("ros_type", "reason"),
    [
        ("geometry_msgs/msg/Vector3", "does not start with a header"),
        ("sensor_msgs/msg/Image", "has no fixed layout"),
        ("sensor_msgs/msg/JointState", "has no fixed layout"),
    ],
)
def test_types_without_a_fixed_layout_are_refused(ros_type: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        layout(ros_type, "")


def test_values_that_do_not_fit_are_refused() -> None:
    with pytest.raises(struct.error):
        layout(SPEEDS_TYPE, "wheels")(0, True, 1.0, True)
    with pytest.raises(StreamError, match=r"cannot write /can at"):
        codec.encode(replace(can_frame(0), channel="\ud800"))
