"""Rate, gaps, losses and jitter of one stream, against numbers worked out by hand."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.health.stream_track import StreamStatistics, StreamTrack

MS = 1_000_000


def fed(
    track: StreamTrack, times_ms: list[int], first: int = 0, reopened: bool = False
) -> list[int]:
    numbers = []
    for index, time_ms in enumerate(times_ms):
        again = reopened and index == 0
        number = track.accept(time_ms * MS, first + index, reopened=again, dropped=0)
        numbers.append(number)
    return numbers


def figures(track: StreamTrack, duration_s: float = 1.0) -> StreamStatistics:
    return track.end_interval(duration_s)


def test_rate_and_jitter_are_of_the_interval() -> None:
    track = StreamTrack(100.0)
    fed(track, list(range(0, 1000, 10)))
    assert figures(track).rate_hz == 100.0
    fed(track, [1000, 1009, 1020, 1029, 1040], first=100)
    found = figures(track, 0.05)
    assert found.rate_hz == pytest.approx(100.0)
    assert found.jitter_s == pytest.approx(math.sqrt(0.8) * 1e-3)  # of 10 9 11 9 11 ms
    assert (found.samples, found.gaps, found.missed) == (105, 0, 0)


def test_the_rate_of_recorded_times_is_that_of_the_samples() -> None:
    """However fast they are played: 100 Hz, and with every second sample missing 50 Hz."""
    track = StreamTrack(100.0)
    fed(track, [0])
    assert track.end_interval(None).rate_hz is None, "one time has no rate"
    fed(track, [10, 20, 30], first=1)
    assert track.end_interval(None).rate_hz == pytest.approx(100.0)
    fed(track, [50, 70], first=4)
    assert track.end_interval(None).rate_hz == pytest.approx(50.0)
    assert track.end_interval(None).rate_hz is None, "nothing came"


def test_silence_has_no_rate_and_no_jitter() -> None:
    track = StreamTrack(100.0)
    fed(track, [0])
    assert figures(track).jitter_s is None
    assert figures(track).rate_hz is None


def test_a_gap_is_longer_than_five_periods() -> None:
    track = StreamTrack(100.0)
    fed(track, [0, 10, 60, 111, 121])  # 50 ms is none, 51 ms is one
    found = figures(track)
    assert found.gaps == 1
    assert found.gap_s == found.longest_gap_s == pytest.approx(0.051)


def test_an_unknown_rate_is_learnt_before_gaps_are_called() -> None:
    track = StreamTrack(None)
    fed(track, [0, 100, *range(110, 400, 10), 1000])
    assert figures(track).gaps == 1


def test_missing_numbers_are_counted_without_those_that_the_recorder_dropped() -> None:
    track = StreamTrack(None)
    fed(track, [0, 10, 20])
    assert track.accept(90 * MS, 9, reopened=False, dropped=4) == 9
    assert figures(track).missed == 2


def test_after_reopening_numbers_go_on_and_the_gap_counts_however_short() -> None:
    track = StreamTrack(100.0)
    assert fed(track, [0, 10, 20]) == [0, 1, 2]
    assert fed(track, [30, 40], reopened=True) == [3, 4]
    found = figures(track)
    assert (found.gaps, found.gap_s, found.missed) == (1, 0.01, 0)


def test_a_device_that_starts_over_without_telling_keeps_its_numbers_rising() -> None:
    track = StreamTrack(100.0)
    assert fed(track, [0, 10]) + fed(track, [20, 30]) + fed(track, [40]) == [0, 1, 2, 3, 4]


def test_stamps_that_go_back_are_counted_and_no_gap() -> None:
    track = StreamTrack(100.0)
    fed(track, [0, 10, 5, 15])
    found = figures(track)
    assert (found.backwards, found.gaps) == (1, 0)


@given(
    st.lists(st.tuples(st.integers(0, 2**32 - 1), st.booleans(), st.integers(0, 9)), max_size=60)
)
def test_numbers_in_the_recording_always_rise(steps: list[tuple[int, bool, int]]) -> None:
    track = StreamTrack(None)
    last = -1
    for index, (sequence, reopened, dropped) in enumerate(steps):
        number = track.accept(index * MS, sequence, reopened=reopened, dropped=dropped)
        assert number > last
        last = number
    assert figures(track).samples == len(steps)
