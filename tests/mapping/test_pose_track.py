"""The queue of poses: which one a depth frame gets, and which are refused or forgotten."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mapping.errors import MappingError
from mapping.pose_track import PoseTrack
from tests.mapping.scenes import pose_sample

SECOND_NS = 1_000_000_000


def _track(*stamps_ns: int, gap_max_ns: int = 100) -> PoseTrack:
    """Return a track whose poses have their stamp as x."""
    track = PoseTrack(gap_max_ns)
    for t_ns in stamps_ns:
        track.add(pose_sample(t_ns, (t_ns, 0.0, 0.0)))
    return track


def _x(track: PoseTrack, t_ns: int) -> float | None:
    pose = track.at(t_ns)
    return None if pose is None else float(pose.transform.translation_m[0])


def test_an_exact_stamp_gets_that_very_pose() -> None:
    track = PoseTrack(100)
    poses = [pose_sample(t_ns, (0.1 * t_ns, 0.2, 0.3)) for t_ns in (10, 20, 30)]
    assert [track.add(pose) for pose in poses] == [True] * 3
    for sample in poses:
        found = track.at(sample.t_ns)
        assert found is not None
        assert found.t_ns == sample.t_ns
        np.testing.assert_array_equal(found.transform.translation_m, sample.position_m)


def test_between_two_poses_it_is_interpolated() -> None:
    track = _track(10, 20, 40)
    assert _x(track, 12) == pytest.approx(12.0)
    assert _x(track, 35) == pytest.approx(35.0)
    assert _x(track, 36) == pytest.approx(36.0)


def test_before_the_first_and_after_the_last_there_is_none() -> None:
    track = _track(10, 20)
    assert _x(track, 9) is None
    assert _x(track, 21) is None
    assert _x(PoseTrack(100), 10) is None
    assert _x(_track(10), 11) is None


def test_asking_for_the_future_forgets_nothing() -> None:
    track = _track(10, 20)
    assert _x(track, 999) is None
    assert _x(track, 15) == pytest.approx(15.0)


def test_a_gap_is_bridged_up_to_its_limit_only() -> None:
    assert _x(_track(10, 110), 60) == pytest.approx(60.0)
    assert _x(_track(10, 111), 60) is None
    # The pose itself is known, whatever is beside it.
    assert _x(_track(10, 111), 111) == 111.0


def test_a_repeated_or_older_pose_is_left_out_and_counted() -> None:
    track = _track(10, 20)
    assert not track.add(pose_sample(20, (7.0, 0.0, 0.0)))
    assert not track.add(pose_sample(15, (7.0, 0.0, 0.0)))
    assert track.out_of_order == 2
    assert track.newest_ns == 20
    assert _x(track, 20) == 20.0


def test_hours_of_poses_without_depth_do_not_pile_up() -> None:
    track = PoseTrack(SECOND_NS)
    for number in range(3000):
        track.add(pose_sample(number * SECOND_NS // 50, (0.02 * number, 0.0, 0.0)))
    assert len(track._poses) == 501
    # A depth frame that comes 9 s late still finds its pose.
    assert _x(track, 51 * SECOND_NS + 1) == pytest.approx(51.0)


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("position_m", (np.nan, 0, 0), r"pose at 5 ns: position is \(nan, 0, 0\) m"),
        ("quat_wxyz", (0, 0, 0, 0), "pose at 5 ns: quaternion wxyz .* has length 0; expected 1"),
        ("covariance", np.full((6, 6), np.nan), "pose at 5 ns has a covariance with a negative"),
        ("covariance", np.full((6, 6), np.inf), "pose at 5 ns has a covariance with a negative"),
        ("covariance", np.diag([0, 0, -1.0, 0, 0, 0]), "expected m.2 and rad.2"),
        ("covariance", np.diag([0, 0, 1e300, 0, 0, 0]), r"or above 1e\+12"),
    ],
)
def test_what_is_no_pose_is_refused(name: str, value: object, reason: str) -> None:
    changes: dict[str, Any] = {name: np.array(value, float)}
    sample = replace(pose_sample(5), **changes)
    with pytest.raises(MappingError, match=reason):
        PoseTrack(100).add(sample)
