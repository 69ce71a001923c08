"""Times of frames, reckoned from the times of reads."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.vibration.stamps import ArrivalTimes

_BYTE_NS = 86_805.5  # 115200 baud, 10 bits
_PERIOD_NS = 10_000_000


def test_a_frame_that_ends_a_read_has_the_time_of_the_read() -> None:
    times = ArrivalTimes(_BYTE_NS, _PERIOD_NS)
    times.note(28, 1_000_000_000)
    assert times.stamp(28, 28) == 1_000_000_000


def test_a_batch_is_dated_back_by_the_period() -> None:
    times = ArrivalTimes(_BYTE_NS, _PERIOD_NS)
    times.note(5 * 28, 1_000_000_000)
    stamps = [times.stamp(28 * n, 28) for n in range(1, 6)]
    assert stamps == [1_000_000_000 - _PERIOD_NS * (5 - n) for n in range(1, 6)]


def test_a_frame_that_was_damaged_takes_its_period_too() -> None:
    times = ArrivalTimes(_BYTE_NS, _PERIOD_NS)
    times.note(3 * 28, 1_000_000_000)
    assert times.stamp(28, 28) == 1_000_000_000 - 2 * _PERIOD_NS  # the second was damaged
    assert times.stamp(84, 28) == 1_000_000_000


def test_the_beginning_of_the_next_frame_shows_that_the_pause_is_over() -> None:
    times = ArrivalTimes(_BYTE_NS, _PERIOD_NS)
    times.note(30, 1_000_000_000)
    pause_ns = _PERIOD_NS - 28 * _BYTE_NS
    assert times.stamp(28, 28) == 1_000_000_000 - round(pause_ns + 2 * _BYTE_NS)


def test_a_frame_is_as_old_as_its_own_last_byte_even_if_it_is_believed_later() -> None:
    times = ArrivalTimes(_BYTE_NS, _PERIOD_NS)
    times.note(20, 1_000_000_000)
    times.note(8, 1_002_000_000)
    times.note(28, 1_012_000_000)
    assert times.stamp(28, 28) == 1_002_000_000
    assert times.stamp(56, 28) == 1_012_000_000


def test_behind_a_polled_reply_only_the_wire_counts() -> None:
    times = ArrivalTimes(_BYTE_NS, None)
    times.note(55, 1_000_000_000)
    assert times.stamp(51, 51) == 1_000_000_000 - round(4 * _BYTE_NS)


@settings(deadline=None)
@given(
    reads=st.lists(st.tuples(st.integers(1, 300), st.integers(0, 20_000_000)), min_size=1),
    period_ns=st.none() | st.integers(1, 10**9),
)
def test_times_increase_and_are_never_later_than_the_read(
    reads: list[tuple[int, int]], period_ns: int | None
) -> None:
    times = ArrivalTimes(_BYTE_NS, period_ns)
    now_ns, received, last_ns, end = 10**9, 0, -1, 28
    for count, pause_ns in reads:
        now_ns, received = now_ns + pause_ns + 1000, received + count
        times.note(count, now_ns)
        while end <= received:
            stamp_ns = times.stamp(end, 28)
            assert last_ns < stamp_ns <= now_ns
            last_ns, end = stamp_ns, end + 28
        times.forget_before(end - 28)
