"""Frames that a run before has dealt with: known by stamp and pixels, and by both alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mapping.errors import MappingError
from mapping.mapper_counts import MapperCounts
from mapping.motion.known_frames import KnownFrames, no_keys
from tests.mapping.scenes import floor_frame

FRAMES = [floor_frame(n * 100_000_000, 0.4 + 0.001 * n) for n in range(5)]


def _after(numbers: list[int], pose_source: str = "mocap") -> tuple[KnownFrames, MapperCounts]:
    """Return what a run knows after one that had those frames."""
    first = KnownFrames(no_keys(), MapperCounts(), "mocap")
    for number in numbers:
        first.add(FRAMES[number])
    counts = MapperCounts()
    return KnownFrames(first.keys, counts, pose_source), counts


def test_frames_of_the_run_before_are_known_in_whatever_order_they_came() -> None:
    known, counts = _after([3, 0, 2])
    assert [known.is_new(frame) for frame in FRAMES] == [False, True, False, False, True]
    assert counts.frames_known == 3
    assert known.is_new(floor_frame(FRAMES[3].t_ns, 0.9))
    assert known.is_new(replace(FRAMES[3], t_ns=FRAMES[3].t_ns + 1))


def test_frames_of_this_run_are_noted_for_the_next_and_are_not_its_own_past() -> None:
    known, _ = _after([0])
    for _ in range(1100):  # more than there is room for at first
        known.add(FRAMES[1])
    assert known.is_new(FRAMES[1])
    assert known.keys is not None
    assert len(known.keys) == 1101
    assert not KnownFrames(known.keys, MapperCounts(), "mocap").is_new(FRAMES[1])


def test_where_nobody_keeps_them_none_is_noted() -> None:
    known = KnownFrames(None, MapperCounts(), "mocap")
    known.add(FRAMES[0])
    assert known.keys is None
    assert known.is_new(FRAMES[0])


@pytest.mark.parametrize("pose_source", ["ego-motion", "ego-motion+alignment"])
def test_poses_that_go_on_from_the_last_run_do_not_suit_a_known_recording(pose_source: str) -> None:
    known, _ = _after([2], pose_source)
    assert known.is_new(FRAMES[1])
    with pytest.raises(MappingError, match=r"depth frame at 200000000 ns already, .* new "):
        known.is_new(FRAMES[2])


def test_a_frame_is_looked_up_by_its_stamp_among_many_of_the_same() -> None:
    keys = np.array([[5, 1], [7, 2], [7, 3], [9, 4]], np.int64)
    frame = replace(FRAMES[0], t_ns=7)
    one = KnownFrames(no_keys(), MapperCounts(), "mocap")
    one.add(frame)
    assert one.keys is not None
    assert KnownFrames(keys, MapperCounts(), "mocap").is_new(frame)
    both = np.concatenate([keys, one.keys])
    assert not KnownFrames(both, MapperCounts(), "mocap").is_new(frame)
