"""Clock samples as messages: nothing is lost, nonsense is refused."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.clocks.clock_sample import ClockSample
from acquisition.errors import StreamError
from acquisition.messages import codec
from acquisition.messages.clock import CLOCK_TYPE
from acquisition.messages.codec import MESSAGE_TYPES
from tests.fakes.recordings import clock_sample

ROW = next(row for row in MESSAGE_TYPES if row.topic == "/clock")
unsigned = st.integers(0, 2**64 - 1)
signed = st.integers(-(2**63), 2**63 - 1)


@given(
    st.builds(
        ClockSample,
        t_ns=st.integers(0, 2**31 * 10**9 - 1),
        source=st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=20),
        host_monotonic_ns=unsigned,
        host_raw_ns=unsigned,
        host_real_ns=unsigned,
        boot_id=st.uuids().map(str),
        offset_ns=signed,
        skew_ppm=st.floats(-1e6, 1e6),
        device_ticks=st.none() | unsigned,
        event=st.sampled_from(("", "suspend")),
        event_ns=signed,
        sequence=st.integers(0, 2**32 - 1),
    )
)
def test_clock_samples_come_back_bit_for_bit(sample: ClockSample) -> None:
    (message,) = codec.encode(sample)
    assert message.topic == "/clock"
    back = codec.decode(ROW, message.cdr, log_time_ns=0, sequence=sample.sequence)
    assert back == sample


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"t_ns": -1}, "does not fit a ROS stamp"),
        ({"device_ticks": -1}, "device_ticks is -1; expected 0 to"),
        ({"host_raw_ns": 2**64}, "host_raw_ns is 18446744073709551616"),
        ({"offset_ns": 2**63}, "offset_ns is"),
        ({"skew_ppm": float("nan")}, "skew is not finite"),
    ],
)
def test_what_does_not_fit_is_refused(changes: dict[str, float], reason: str) -> None:
    sample = replace(clock_sample(1), **changes)  # type: ignore[arg-type]  # any field
    with pytest.raises(StreamError, match=f"cannot write /clock at .*{reason}"):
        codec.encode(sample)


def test_a_skew_that_is_no_number_is_refused() -> None:
    (message,) = codec.encode(clock_sample(1))
    one = replace(clock_sample(1), skew_ppm=0.0)
    (zero,) = codec.encode(one)
    start = next(i for i, (a, b) in enumerate(zip(message.cdr, zero.cdr, strict=True)) if a != b)
    start -= start % 4
    data = bytearray(zero.cdr)
    data[start : start + 8] = b"\xff" * 8
    with pytest.raises(StreamError, match="bad message on /clock"):
        codec.decode(ROW, bytes(data), log_time_ns=0, sequence=0)


def test_the_schema_is_complete() -> None:
    text = codec.schema_text(CLOCK_TYPE)
    assert "uint64 device_ticks" in text
    assert "MSG: std_msgs/Header" in text
