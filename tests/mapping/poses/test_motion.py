"""Poses as motions: trembling is no way, and depth is not needed."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mapping.geometry import RigidTransform, UncertainPose
from mapping.motion.pose_errors import ABSOLUTE, ALIGNED, RELATIVE
from mapping.poses.frame_covariance import frame_covariance
from mapping.poses.motion import MotionTracker
from mapping.poses.recorded import RecordedPoses

SECOND_NS = 1_000_000_000


def _pose(t_s: float, x_m: float) -> UncertainPose:
    transform = RigidTransform(np.eye(3), np.array([x_m, 0.0, 0.0]))
    return UncertainPose(round(t_s * SECOND_NS), transform, np.eye(6))


def _tracker() -> MotionTracker:
    return MotionTracker(RecordedPoses(0.2), with_covariance=True)


def test_way_adds_up_in_steps() -> None:
    tracker = _tracker()
    ways = [tracker.step(_pose(0.1 * n, 0.02 * n)) for n in range(31)]
    told = [motion for motion in ways if motion is not None]
    assert len(told) == 10
    assert sum(motion.distance_m for motion in told) == pytest.approx(0.6)
    assert told[-1].position_m[0] == pytest.approx(0.6)


class _Unsure(RecordedPoses):
    def motion_covariance(
        self,
        before: UncertainPose,
        after: UncertainPose,
    ) -> NDArray[np.float64]:
        return np.eye(4)


def test_only_motions_that_no_map_held_are_uncertain() -> None:
    """The first frame has no map; from 1.0 to 1.5 s nothing is seen."""
    tracker = MotionTracker(_Unsure(0.2), with_covariance=False)
    free = [n == 0 or 10 <= n <= 15 for n in range(31)]
    ways = [tracker.step(_pose(0.1 * n, 0.06 * n), is_free=free[n]) for n in range(31)]
    uncertain = [n for n, motion in enumerate(ways) if motion and motion.covariance.any()]
    assert uncertain == list(range(10, 17))


def test_trembling_is_no_way() -> None:
    tracker = _tracker()
    random = np.random.default_rng(1)
    told = [tracker.step(_pose(0.1 * n, 0.003 * random.standard_normal())) for n in range(200)]
    motions = [motion for motion in told if motion is not None]
    assert len(motions) == pytest.approx(19, abs=1)
    assert all(motion.distance_m == 0.0 for motion in motions)


def test_an_earlier_pose_is_no_motion() -> None:
    tracker = _tracker()
    assert tracker.step(_pose(5.0, 0.0)) is None
    assert tracker.step(_pose(4.0, 1.0)) is None
    assert not tracker.is_overdue(7 * SECOND_NS)
    assert tracker.is_overdue(8 * SECOND_NS)


def test_a_frame_carries_what_is_not_counted_elsewhere() -> None:
    covariance = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    assert frame_covariance(covariance, ABSOLUTE) is covariance
    relative = frame_covariance(covariance, RELATIVE)
    np.testing.assert_array_equal(np.diag(relative), [0.0, 0.0, 0.0, 4.0, 5.0, 0.0])
    aligned = np.sqrt(np.diag(frame_covariance(covariance, ALIGNED)))
    tilt = ALIGNED.frame_sigma_rad
    np.testing.assert_allclose(aligned, [0.0, 0.0, ALIGNED.frame_sigma_m, tilt, tilt, 0.0])
