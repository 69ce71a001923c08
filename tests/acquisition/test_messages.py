"""Samples as ROS 2 messages: there and back bit for bit, and StreamError on any nonsense."""

from __future__ import annotations

import dataclasses
import tracemalloc
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from acquisition.errors import StreamError
from acquisition.health.diagnostics import DeviceStatus, Diagnostics, Level
from acquisition.messages import codec
from acquisition.messages.codec import MESSAGE_TYPES, MessageType, typestore
from acquisition.messages.depth import CameraInfo, DepthImage
from acquisition.messages.frames import StaticTransform, StaticTransforms
from drivers.samples import AccelerationSample, CameraIntrinsics, DepthFrame, PoseSample
from tests.fakes.device_samples import can_frame, vibration, wheel_twist, with_ticks, yaw_rate
from tests.fakes.recordings import MOUNT, acceleration, clock_sample, depth_frame, pose, same

T_NS = 1_234_567_890_123_456_789
DIAGNOSTICS = Diagnostics(
    T_NS,
    (
        DeviceStatus(Level.WARN, "gyro", "2 gaps", "A7", {"rate_hz": "399.8", "gaps": "2"}),
        DeviceStatus(Level.STALE, "wheels", "", "", {}),
    ),
)
EXAMPLES: dict[str, codec.Recordable] = {
    "/tf_static": StaticTransforms(T_NS, (MOUNT, MOUNT)),
    "/depth/camera_info": depth_frame(5, T_NS),
    "/depth/image": depth_frame(5, T_NS),
    "/mocap/pose": pose(5, T_NS),
    "/acceleration": acceleration(5, T_NS),
    "/clock": clock_sample(5, T_NS),
    "/vibration": vibration(5, T_NS),
    "/gyro": yaw_rate(5, T_NS),
    "/gyro/raw": yaw_rate(5, T_NS),
    "/can": can_frame(5, T_NS),
    "/wheels": wheel_twist(5, T_NS),
    "/wheels/speeds": wheel_twist(5, T_NS),
    "/depth/ticks": with_ticks(5, T_NS),
    "/diagnostics": DIAGNOSTICS,
}
times_ns = st.integers(0, 2**31 * 10**9 - 1)
sequences = st.integers(0, 2**32 - 1)
numbers = st.floats(-1e9, 1e9, allow_subnormal=True)
positions = hnp.arrays(np.float64, 3, elements=numbers)


@st.composite
def unit_quaternions(draw: st.DrawFn) -> np.ndarray[Any, np.dtype[np.float64]]:
    quat = draw(hnp.arrays(np.float64, 4, elements=st.floats(-1.0, 1.0)))
    norm = float(np.linalg.norm(quat))
    return quat / norm if norm > 1e-3 else np.array([1.0, 0.0, 0.0, 0.0])


def row_of(topic: str) -> MessageType:
    return next(row for row in MESSAGE_TYPES if row.topic == topic)


def there_and_back(sample: codec.Recordable, sequence: int = 0) -> list[codec.Record]:
    return [
        codec.decode(row_of(message.topic), message.cdr, log_time_ns=sample.t_ns, sequence=sequence)
        for message in codec.encode(sample)
    ]


@given(
    times_ns,
    hnp.arrays(np.uint16, hnp.array_shapes(min_dims=2, max_dims=2, max_side=9)),
    st.floats(1e-3, 1e4),
    sequences,
)
def test_depth_frames_come_back_bit_for_bit(
    t_ns: int, depth_mm: np.ndarray[Any, np.dtype[np.uint16]], focal_px: float, sequence: int
) -> None:
    height, width = depth_mm.shape
    camera = CameraIntrinsics(width, height, focal_px, focal_px / 3, 0.1, focal_px / 7)
    frame = DepthFrame(t_ns, depth_mm, camera, sequence)
    info, image = there_and_back(frame, sequence)
    assert info == CameraInfo(t_ns, camera)
    assert isinstance(image, DepthImage)
    assert same(DepthFrame(image.t_ns, image.depth_mm, camera, image.sequence), frame)
    assert not image.depth_mm.flags.writeable


@given(times_ns, positions, unit_quaternions(), hnp.arrays(np.float64, (6, 6), elements=numbers))
def test_poses_come_back_bit_for_bit(t_ns: int, position: Any, quat: Any, covariance: Any) -> None:
    sample = PoseSample(t_ns, position, quat, covariance, 9)
    (back,) = there_and_back(sample, 9)
    assert isinstance(back, PoseSample)
    assert same(back, sample)
    for array in (back.position_m, back.quat_wxyz, back.covariance):
        assert not array.flags.writeable


@given(times_ns, positions, sequences)
def test_accelerations_come_back_bit_for_bit(t_ns: int, force: Any, sequence: int) -> None:
    sample = AccelerationSample(t_ns, force, sequence)
    (back,) = there_and_back(sample, sequence)
    assert isinstance(back, AccelerationSample)
    assert same(back, sample)


@given(
    times_ns, st.lists(st.tuples(st.text(), st.text(), positions, unit_quaternions()), max_size=3)
)
def test_transforms_come_back_bit_for_bit(t_ns: int, parts: list[Any]) -> None:
    sample = StaticTransforms(t_ns if parts else 0, tuple(StaticTransform(*p) for p in parts))
    (back,) = there_and_back(sample)
    assert isinstance(back, StaticTransforms)
    assert same(back, sample)


def test_the_ros_quaternion_has_w_last() -> None:
    (encoded,) = codec.encode(dataclasses.replace(pose(0), quat_wxyz=np.array([1.0, 0, 0, 0])))
    ros: Any = typestore().deserialize_cdr(
        encoded.cdr, "geometry_msgs/msg/PoseWithCovarianceStamped"
    )
    assert (ros.pose.pose.orientation.w, ros.pose.pose.orientation.x) == (1.0, 0.0)
    assert ros.header.frame_id == "world"


def test_an_accelerometer_claims_neither_orientation_nor_rotation() -> None:
    (encoded,) = codec.encode(acceleration(0))
    ros: Any = typestore().deserialize_cdr(encoded.cdr, "sensor_msgs/msg/Imu")
    assert ros.orientation_covariance[0] == ros.angular_velocity_covariance[0] == -1.0
    assert ros.linear_acceleration.z == 9.81


def test_a_rounded_quaternion_of_another_program_is_normalised() -> None:
    data = changed("/mocap/pose", lambda m: setattr(m.pose.pose.orientation, "w", 0.5001))
    back = decoded("/mocap/pose", data)
    assert isinstance(back, PoseSample)
    assert np.linalg.norm(back.quat_wxyz) == pytest.approx(1.0, abs=1e-15)


def changed(topic: str, change: Any) -> bytes:
    """Return an example message after changing its ROS object."""
    row = row_of(topic)
    ros = row.encode(EXAMPLES[topic])
    change(ros)
    return bytes(typestore().serialize_cdr(ros, row.ros_type))


def decoded(topic: str, data: bytes) -> codec.Record:
    return codec.decode(row_of(topic), data, log_time_ns=42, sequence=0)


@pytest.mark.parametrize(
    ("topic", "change", "reason"),
    [
        ("/depth/image", lambda m: setattr(m, "encoding", "8UC1"), "'8UC1' little-endian"),
        ("/depth/image", lambda m: setattr(m, "is_bigendian", 1), "big-endian"),
        ("/depth/image", lambda m: setattr(m, "step", 15), "step 15"),
        ("/depth/image", lambda m: setattr(m, "height", 5), "has 96 bytes"),
        ("/depth/image", lambda m: setattr(m, "width", 0), "0x6 px"),
        ("/depth/image", lambda m: setattr(m.header.stamp, "sec", -1), "stamp of -1 s"),
        ("/depth/image", lambda m: setattr(m.header.stamp, "nanosec", 10**9), "1e9-1 ns"),
        ("/depth/camera_info", lambda m: m.k.__setitem__(0, np.nan), "expected finite"),
        ("/depth/camera_info", lambda m: m.k.__setitem__(4, 0.0), "fx, fy > 0"),
        ("/depth/camera_info", lambda m: m.k.__setitem__(1, 0.1), "skew"),
        ("/depth/camera_info", lambda m: m.d.__setitem__(1, 0.1), "rectified"),
        ("/depth/camera_info", lambda m: setattr(m, "width", 0), "0x6 px"),
        ("/mocap/pose", lambda m: setattr(m.pose.pose.position, "x", np.nan), "position is not"),
        ("/mocap/pose", lambda m: setattr(m.pose.pose.orientation, "x", np.inf), "quaternion"),
        ("/mocap/pose", lambda m: setattr(m.pose.pose.orientation, "x", 0.6), "has length 1.05"),
        ("/mocap/pose", lambda m: setattr(m.pose.pose.orientation, "x", 1e300), "length 1e+300"),
        ("/acceleration", lambda m: setattr(m.linear_acceleration, "y", -np.inf), "not finite"),
        (
            "/acceleration",
            lambda m: m.linear_acceleration_covariance.__setitem__(0, -1.0),
            "not measured",
        ),
        ("/vibration", lambda m: setattr(m, "quantity", 0), "quantity is 0; expected 1 to 3"),
        ("/vibration", lambda m: setattr(m, "statistic", 5), "statistic is 5; expected 1 to 4"),
        ("/vibration", lambda m: setattr(m, "frequency_hz", np.full(3, np.inf)), "is infinite"),
        ("/vibration", lambda m: setattr(m, "temperature_c", np.inf), "temperature is infinite"),
        ("/gyro", lambda m: setattr(m.angular_velocity, "z", np.nan), "rate is not finite"),
        ("/gyro", lambda m: m.angular_velocity_covariance.__setitem__(0, -1.0), "not measured"),
        ("/gyro/raw", lambda m: setattr(m.header.stamp, "sec", -1), "stamp of -1 s"),
        ("/can", lambda m: setattr(m, "dlc", 9), "has 9 bytes"),
        ("/can", lambda m: setattr(m, "id", 2**29), "arbitration id is 536870912"),
        ("/wheels", lambda m: setattr(m.twist.twist.linear, "x", np.inf), "speed is not finite"),
        ("/wheels", lambda m: m.twist.covariance.__setitem__(0, -1.0), "variance of the speed"),
        ("/wheels", lambda m: m.twist.covariance.__setitem__(35, np.nan), "of the yaw rate is nan"),
        ("/wheels/speeds", lambda m: setattr(m, "left_m_s", np.inf), "left speed is infinite"),
        ("/tf_static", lambda m: setattr(m.transforms[1].transform.rotation, "w", 0.0), "length"),
    ],
)
def test_a_message_that_makes_no_sense_is_refused_in_one_line(
    topic: str, change: Any, reason: str
) -> None:
    with pytest.raises(StreamError) as caught:
        decoded(topic, changed(topic, change))
    text = str(caught.value)
    assert text.startswith(f"bad message on {topic} at 42 ns: ")
    assert reason in text
    assert "\n" not in text


def test_a_covariance_that_is_not_finite_is_refused() -> None:
    def change(message: Any) -> None:
        message.pose.covariance = np.full(36, np.inf)

    with pytest.raises(StreamError, match="covariance is not finite"):
        decoded("/mocap/pose", changed("/mocap/pose", change))


@pytest.mark.parametrize(
    ("sample", "reason"),
    [
        (pose(0, -1), "cannot write /mocap/pose at -1 ns"),
        (pose(0, 2**31 * 10**9), "does not fit a ROS stamp"),
        (dataclasses.replace(pose(0), position_m=np.full(3, np.nan)), "position is not finite"),
        (dataclasses.replace(pose(0), covariance=np.zeros(36)), "expected shape"),
        (dataclasses.replace(pose(0), quat_wxyz=np.zeros(4)), "length 0"),
        (dataclasses.replace(depth_frame(0), depth_mm=np.zeros((2, 2), np.uint16)), "2x2 px"),
        (
            dataclasses.replace(depth_frame(0), depth_mm=np.zeros((6, 8), np.float32)),
            "dtype float32",
        ),
    ],
)
def test_a_sample_that_makes_no_sense_is_not_written(sample: codec.Recordable, reason: str) -> None:
    with pytest.raises(StreamError, match=reason):
        codec.encode(sample)


@pytest.mark.parametrize("sequence", [-1, 2**32])
def test_a_sequence_beyond_32_bits_is_refused(sequence: int) -> None:
    with pytest.raises(StreamError, match="sequence"):
        codec.checked_sequence(pose(sequence))


def test_diagnostics_come_back_as_they_were() -> None:
    assert there_and_back(DIAGNOSTICS) == [DIAGNOSTICS]


def test_a_status_of_an_unknown_level_is_refused() -> None:
    def change(message: Any) -> None:
        message.status[0].level = 9

    with pytest.raises(StreamError, match="9 is not a valid Level"):
        decoded("/diagnostics", changed("/diagnostics", change))


def example_cdr(row: MessageType) -> bytes:
    encoded = codec.encode(EXAMPLES[row.topic])
    return next(message.cdr for message in encoded if message.topic == row.topic)


@st.composite
def nonsense(draw: st.DrawFn) -> tuple[MessageType, bytes]:
    """Return random bytes, or a good message after truncation, growth and a few changed bytes."""
    row = draw(st.sampled_from(MESSAGE_TYPES))
    if draw(st.booleans()):
        return row, b"\x00\x01\x00\x00" + draw(st.binary(max_size=400))
    data = bytearray(example_cdr(row)[: draw(st.integers(0, 2000))])
    for _ in range(draw(st.integers(0, 4))):
        if data:
            data[draw(st.integers(0, len(data) - 1))] = draw(st.integers(0, 255))
    return row, bytes(data) + draw(st.binary(max_size=8))


@settings(max_examples=700)
@given(nonsense())
def test_nothing_but_stream_error_escapes_the_decoder(case: tuple[MessageType, bytes]) -> None:
    row, data = case
    try:
        codec.decode(row, data, log_time_ns=0, sequence=0)
    except StreamError as error:
        text = str(error)
        one_line = text.startswith("bad message on ") and "\n" not in text
    else:
        one_line = True
    assert one_line


@pytest.mark.parametrize("row", MESSAGE_TYPES, ids=lambda row: row.topic)
def test_absurd_lengths_do_not_take_memory(row: MessageType) -> None:
    good = example_cdr(row)
    codec.decode(row, good, log_time_ns=0, sequence=0)
    tracemalloc.start()
    try:
        for position in range(4, len(good) - 4, 4):
            bad = good[:position] + b"\xff\xff\xff\x7f" + good[position + 4 :]
            try:
                codec.decode(row, bad, log_time_ns=0, sequence=0)
            except StreamError:
                continue
        peak_bytes = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak_bytes < 1_000_000
