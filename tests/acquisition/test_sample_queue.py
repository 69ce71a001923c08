"""The queue between a source and the writer: bounded, and honest about what it threw away."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.clocks.clock_follower import ClockTuning
from acquisition.clocks.host_clock import HostClock
from acquisition.recording.intake import Intake
from acquisition.recording.sample_queue import SMALL_SAMPLE_BYTES, SampleQueue, size_in_memory
from drivers.samples import AccelerationSample
from drivers.source import SourceInfo, TimeBase
from tests.fakes.recordings import acceleration, depth_frame, pose

INFO = SourceInfo("imu", "m", "s", (AccelerationSample,), "monotonic")


@given(
    st.lists(st.one_of(st.integers(0, 9), st.none()), max_size=40),  # a put of so many, or a take
    st.integers(0, 12),
)
def test_every_sample_is_taken_or_counted(steps: list[int | None], room: int) -> None:
    queue = SampleQueue(room * SMALL_SAMPLE_BYTES)
    given_, taken, told = 0, 0, 0
    for step in [*steps, None]:
        if step is None:
            for batch in queue.take():
                taken += len(batch.samples)
                told += batch.dropped_before.total()
        else:
            queue.put(INFO, [acceleration(given_ + i) for i in range(step)])
            given_ += step
        state = queue.state()
        assert state.size_bytes <= state.highest_bytes <= state.limit_bytes
    assert taken + queue.state().dropped == given_
    assert told <= queue.state().dropped


def test_what_was_dropped_is_told_with_the_next_batch() -> None:
    queue = SampleQueue(2 * SMALL_SAMPLE_BYTES)
    queue.put(INFO, [acceleration(i) for i in range(5)])
    assert [len(batch.samples) for batch in queue.take()] == [2]
    queue.put(INFO, [acceleration(5)])
    (batch,) = queue.take()
    assert (batch.dropped_before, batch.samples[0].sequence) == ({AccelerationSample: 3}, 5)


def test_a_reopened_source_is_told_even_when_nothing_fits() -> None:
    queue = SampleQueue(0)
    queue.put(INFO, [acceleration(0)], reopened=True)
    (batch,) = queue.take()
    assert (batch.reopened, list(batch.samples)) == (True, [])


def test_a_depth_frame_takes_its_pixels() -> None:
    assert size_in_memory(depth_frame(0)) == SMALL_SAMPLE_BYTES + 2 * 48
    assert size_in_memory(pose(0)) == SMALL_SAMPLE_BYTES


@pytest.mark.parametrize(("time_base", "rate_hz"), [("monotonic", 11.0), ("recorded", 100.0)])
def test_recorded_times_make_their_own_rate(time_base: TimeBase, rate_hz: float) -> None:
    """The same eleven samples, 10 ms apart, that came within a second."""
    intake = Intake(HostClock(), {}, ClockTuning())
    queue = SampleQueue(10**6)
    info = SourceInfo("imu", "m", "s", (AccelerationSample,), time_base)
    queue.put(info, [acceleration(i, i * 10_000_000) for i in range(11)])
    for batch in queue.take():
        intake.stamped(batch)
    (statistics,) = intake.end_interval(1.0).values()
    assert statistics.rate_hz == pytest.approx(rate_hz)


def test_what_the_queue_dropped_of_one_stream_is_missing_in_no_stream() -> None:
    """Of two streams, one comes back a batch later than the other."""
    intake = Intake(HostClock(), {}, ClockTuning())
    queue = SampleQueue(2 * SMALL_SAMPLE_BYTES)
    first = [make(i, i) for i in (0, 1) for make in (acceleration, pose)]
    for samples in (first, [acceleration(2, 2)], [pose(2, 2)]):
        queue.put(INFO, samples)
        for batch in queue.take():
            intake.stamped(batch)
    assert queue.state().dropped == 2
    assert [s.missed for s in intake.end_interval(1.0).values()] == [0, 0]


def test_each_stream_of_a_reopened_source_counts_its_gap() -> None:
    intake = Intake(HostClock(), {AccelerationSample: 1000.0}, ClockTuning())
    queue = SampleQueue(10**6)
    info = SourceInfo("both", "m", "s", (AccelerationSample, type(pose(0))), "monotonic")
    queue.put(info, [acceleration(0, 0), pose(0, 0)])
    queue.put(info, [acceleration(0, 10)], reopened=True)
    queue.put(info, [pose(0, 20)])
    items = [item for batch in queue.take() for item in intake.stamped(batch)]
    assert len(items) == 4
    statistics = intake.end_interval(1.0)
    assert [s.gaps for s in statistics.values()] == [1, 1]
    assert statistics[AccelerationSample].nominal_rate_hz == 1000.0
