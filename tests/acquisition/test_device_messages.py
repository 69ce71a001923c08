"""Samples of devices as messages: there and back bit for bit, and readable by others."""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from rosbags.highlevel import AnyReader

from acquisition.errors import StreamError
from acquisition.messages import codec
from acquisition.messages.companions import Companion, Companions
from acquisition.messages.frames import StaticTransforms
from acquisition.messages.ros_types import ros_class
from acquisition.messages.vibration import QUANTITIES, STATISTICS
from acquisition.replay import Replay
from drivers.errors import EndOfSource
from drivers.samples import (
    CanFrameSample,
    Sample,
    VibrationQuantity,
    VibrationSample,
    VibrationStatistic,
    WheelTwistSample,
    YawRateSample,
)
from drivers.source import SOURCES
from tests.fakes.device_samples import (
    MAKERS,
    can_frame,
    device_recording,
    one_of_each,
    vibration,
    wheel_twist,
    with_ticks,
    yaw_rate,
)
from tests.fakes.foreign import foreign
from tests.fakes.recordings import START_NS, reader_of, same

times_ns = st.integers(0, 2**31 * 10**9 - 1)
sequences = st.integers(0, 2**32 - 1)
numbers = st.floats(allow_nan=False, allow_infinity=False)
not_infinite = st.floats(allow_infinity=False)
axes = hnp.arrays(np.float64, 3, elements=not_infinite)
sigmas = st.just(0.0) | st.floats(1e-150, 1e150)


def unchecked(sample: Any, **changes: object) -> Sample:
    """Return a sample that a type checker would not let pass."""
    changed = replace(sample, **changes)
    assert isinstance(changed, Sample)
    return changed


def there_and_back(*content: Sample) -> list[Sample]:
    """Return the samples of a recording, by way of the writer and the reader."""
    _, *found = reader_of(device_recording(content))
    samples = [message.sample for message in found]
    assert [message.sequence for message in found] == [sample.sequence for sample in content]
    return samples  # type: ignore[return-value] # the only transforms were taken off


vibrations = st.builds(
    VibrationSample,
    times_ns,
    axes,
    axes,
    st.sampled_from(get_args(VibrationQuantity)),
    st.sampled_from(get_args(VibrationStatistic)),
    st.none() | not_infinite,
    sequences,
    st.none() | st.integers(0, 2**64 - 1),
)
yaw_rates = st.builds(
    YawRateSample,
    times_ns,
    numbers,
    st.none() | not_infinite,
    st.none() | st.integers(-(2**31), 2**31 - 1),
    sequences,
)
wheel_twists = st.builds(
    WheelTwistSample,
    times_ns,
    numbers,
    numbers,
    sigmas,
    sigmas,
    st.none() | not_infinite,
    st.none() | not_infinite,
    sequences,
)


@st.composite
def can_frames(draw: st.DrawFn) -> CanFrameSample:
    is_extended, is_error = draw(st.booleans()), draw(st.booleans())
    return CanFrameSample(
        draw(times_ns),
        draw(st.integers(0, 2**29 - 1 if is_extended or is_error else 2**11 - 1)),
        is_extended=is_extended,
        is_remote=draw(st.booleans()),
        is_error=is_error,
        data=draw(st.binary(max_size=8)),
        channel=draw(st.text(max_size=20)),
        sequence=draw(sequences),
    )


@given(st.one_of(vibrations, yaw_rates, wheel_twists, can_frames()))
def test_samples_of_devices_come_back_bit_for_bit(sample: Sample) -> None:
    (back,) = there_and_back(sample)
    assert same(back, sample)


@given(st.none() | st.integers(0, 2**64 - 1))
def test_ticks_of_a_depth_camera_come_back(ticks: int | None) -> None:
    frame = replace(with_ticks(1), device_ticks=ticks)
    (back,) = there_and_back(frame)
    assert same(back, frame)


def test_one_of_each_is_recorded_read_and_replayed(tmp_path: Path) -> None:
    content = [s for i in range(3) for s in one_of_each(i, START_NS + i * 10**7)]
    assert {type(sample) for sample in content} == set(get_args(Sample))
    for back, sample in zip(there_and_back(*content), content, strict=True):
        assert same(back, sample)

    path = tmp_path / "each.mcap"
    path.write_bytes(device_recording(content))
    source = Replay(path, speed=0.0)
    assert set(source.open().produces) == set(get_args(Sample))
    played = [sample for _ in content for sample in source.read(0.0)]
    with pytest.raises(EndOfSource):
        source.read(0.0)
    source.close()
    for back, sample in zip(played, content, strict=True):
        assert same(back, sample)


def test_no_driver_comes_from_a_room_above() -> None:
    assert {path.split(".")[0] for path in SOURCES.values()} == {"drivers"}


def test_samples_of_the_same_time_keep_their_own_companions() -> None:
    content = [yaw_rate(i) for i in range(4)] + [wheel_twist(i) for i in range(4)]
    for back, sample in zip(there_and_back(*content), content, strict=True):
        assert same(back, sample)


def test_a_companion_finds_its_sample_from_far_behind() -> None:
    """More samples wait than a second has, as with a window that the user has enlarged."""
    content = [yaw_rate(i, START_NS + i * 10**6) for i in range(5000)]
    reader = reader_of(device_recording(content), reorder_window_ns=10**12)
    _, *found = reader
    assert all(same(m.sample, s) for m, s in zip(found, content, strict=True))


def test_a_companion_may_come_after_its_sample() -> None:
    content = [(m.topic, m.cdr, START_NS) for m in reversed(codec.encode(yaw_rate(0)))]
    (found,) = reader_of(foreign(content))
    assert same(found.sample, yaw_rate(0))


def test_companions_without_a_sample_do_not_pile_up() -> None:
    companions = Companions()
    for t_ns in range(70_000):
        companions.add(Companion(t_ns, YawRateSample, {"raw_counts": t_ns}))
    assert companions.take(YawRateSample, 0) == {}
    assert companions.take(YawRateSample, 69_999) == {"raw_counts": 69_999}


def test_what_has_nothing_to_say_is_not_written() -> None:
    silent = replace(wheel_twist(0), left_m_s=None, right_m_s=None)
    assert [m.topic for m in codec.encode(silent)] == ["/wheels"]
    no_clock = replace(with_ticks(0), device_ticks=None)
    assert "/depth/ticks" not in [m.topic for m in codec.encode(no_clock)]


def test_an_imu_of_another_program_is_a_rate_without_counts() -> None:
    row = codec.find("/gyro", "sensor_msgs/msg/Imu")
    assert row is not None
    imu = next(m for m in codec.encode(yaw_rate(7)) if m.topic == "/gyro")
    back = codec.decode(row, imu.cdr, log_time_ns=0, sequence=7)
    assert back == replace(yaw_rate(7), raw_counts=None, temperature_c=None)


def test_the_words_of_a_vibration_are_the_constants_of_its_definition() -> None:
    kind: Any = ros_class("terravibe_msgs/msg/TriaxialVibration")
    units = {"displacement": "M", "velocity": "M_S", "acceleration": "M_S2"}
    for word, code in QUANTITIES.items():
        assert getattr(kind, f"QUANTITY_{word.upper()}_{units[word]}") == code
    for statistic, code in STATISTICS.items():
        assert getattr(kind, f"STATISTIC_{statistic.upper().replace('-', '_')}") == code
    assert set(QUANTITIES) == set(get_args(VibrationQuantity))
    assert set(STATISTICS) == set(get_args(VibrationStatistic))


@pytest.mark.parametrize(
    ("sample", "reason"),
    [
        (unchecked(vibration(0), quantity="jerk"), "cannot write /vibration .*'jerk'"),
        (unchecked(vibration(0), statistic="mean"), "'mean'"),
        (replace(vibration(0), amplitude=np.full(3, np.inf)), "amplitude is infinite"),
        (replace(vibration(0), frequency_hz=np.zeros(2)), "expected shape"),
        (replace(vibration(0), temperature_c=np.inf), "temperature is infinite"),
        (replace(vibration(0), device_ticks=-1), "device ticks is -1; expected 0"),
        (replace(vibration(0), sequence=2**32), "sequence is 4294967296"),
        (replace(yaw_rate(0), rate_rad_s=np.nan), "cannot write /gyro .*rate is not finite"),
        (replace(yaw_rate(0), raw_counts=2**31), "cannot write /gyro/raw .*raw counts is 2147"),
        (replace(wheel_twist(0), speed_m_s=np.inf), "speed is not finite"),
        (replace(wheel_twist(0), yaw_rate_rad_s=np.nan), "yaw rate is not finite"),
        (replace(wheel_twist(0), speed_sigma_m_s=-0.1), "sigma of the speed is -0.1"),
        (replace(wheel_twist(0), speed_sigma_m_s=np.nan), "sigma of the speed is nan"),
        (replace(wheel_twist(0), yaw_rate_sigma_rad_s=1e-170), "sigma of the yaw rate is 1e-170"),
        (replace(wheel_twist(0), yaw_rate_sigma_rad_s=np.inf), "sigma of the yaw rate is inf"),
        (replace(wheel_twist(0), left_m_s=-np.inf), "left speed is infinite"),
        (replace(can_frame(0), data=bytes(9)), "cannot write /can .*the frame has 9 bytes"),
        (replace(can_frame(0), is_extended=False), "expected 0 to 2047"),
        (replace(can_frame(0), arbitration_id=2**29), "expected 0 to 536870911"),
        (replace(can_frame(0), channel="\ud800"), "surrogates not allowed"),
        (replace(with_ticks(0), device_ticks=2**64), "cannot write /depth/ticks .*device ticks"),
    ],
)
def test_a_sample_that_makes_no_sense_is_not_written(sample: Sample, reason: str) -> None:
    with pytest.raises(StreamError, match=reason):
        codec.encode(sample)


@pytest.fixture
def decoded_by_rosbags(tmp_path: Path) -> dict[str, Any]:
    """Return each topic's message, read with nothing but the schemas in the file."""
    path = tmp_path / "each.mcap"
    path.write_bytes(device_recording(one_of_each()))
    with AnyReader([path]) as reader:
        return {
            connection.topic: reader.deserialize(data, connection.msgtype)
            for connection, _, data in reader.messages()
        }


def test_rosbags_decodes_every_topic(decoded_by_rosbags: dict[str, Any]) -> None:
    found = decoded_by_rosbags
    rows = codec.types_of([StaticTransforms, *get_args(Sample)])
    assert set(found) == {row.topic for row in rows} - codec.left_out_by("raw")
    shaken = found["/vibration"]
    assert (shaken.header.frame_id, shaken.host_receive_ns) == ("vibration_sensor", START_NS)
    assert (shaken.quantity, shaken.statistic) == (1, 2)
    assert (shaken.QUANTITY_DISPLACEMENT_M, shaken.STATISTIC_PEAK_TO_PEAK) == (1, 2)
    assert (shaken.sequence, shaken.amplitude[1]) == (5, 2e-6)
    assert found["/gyro/raw"].raw_counts == -5
    frame = found["/can"]
    assert (frame.id, frame.dlc, frame.header.frame_id) == (0x02021542, 4, "can0")
    assert frame.data.tolist() == [5, 0, 0, 0, 0, 0, 0, 0]
    assert found["/wheels/speeds"].left_m_s == -0.2
    assert found["/depth/ticks"].ticks == 165_000


def test_a_gyro_claims_the_rate_about_one_axis_only(decoded_by_rosbags: dict[str, Any]) -> None:
    imu = decoded_by_rosbags["/gyro"]
    assert imu.orientation_covariance[0] == imu.linear_acceleration_covariance[0] == -1.0
    assert imu.angular_velocity.z == yaw_rate(5).rate_rad_s
    assert not imu.angular_velocity_covariance.any()


def test_wheels_claim_forward_speed_and_yaw_rate_only(decoded_by_rosbags: dict[str, Any]) -> None:
    covariance = decoded_by_rosbags["/wheels"].twist.covariance.reshape(6, 6)
    assert np.array_equal(covariance, np.diag(np.diag(covariance)))
    assert np.diag(covariance).tolist() == [0.013**2, 1e6, 1e6, 1e6, 1e6, 0.027**2]


@pytest.mark.parametrize("make", MAKERS, ids=lambda make: make.__name__)
def test_every_field_of_a_sample_is_recorded(make: Any) -> None:
    """A field that the examples leave at its default would hide that it is not recorded."""
    sample = make(5)
    for field in dataclasses.fields(sample):
        if field.default is not dataclasses.MISSING:
            assert getattr(sample, field.name) != field.default
