"""The reorder buffer: sorted, complete up to what it calls late, and late only for good reason."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from acquisition.stream.reorder import ReorderBuffer


@given(st.lists(st.integers(0, 1000)), st.integers(0, 300))
def test_what_leaves_is_sorted_and_everything_else_is_late(times: list[int], window: int) -> None:
    buffer: ReorderBuffer[tuple[int, int]] = ReorderBuffer(window)
    left: list[tuple[int, int]] = []
    late: list[tuple[int, int]] = []
    for number, time in enumerate(times):
        if not buffer.push(time, (time, number)):
            late.append((time, number))
            assert max(times[:number]) - time > window
        left += buffer.ready()
        assert all(max(times[: number + 1]) - t >= window for t, _ in left)
    left += buffer.rest()
    assert left == sorted(left)
    assert sorted(left + late) == sorted(zip(times, range(len(times)), strict=True))
