"""The poses of the tracked body, and the one at the time of a depth frame."""

from __future__ import annotations

from collections import deque

import numpy as np

from drivers.samples import PoseSample
from mapping.errors import MappingError
from mapping.geometry import RigidTransform, UncertainPose, interpolate_pose

# Poses this much older than the newest are forgotten: no depth frame comes that late. Without
# a limit, hours of poses without depth would pile up.
_HISTORY_NS = 10_000_000_000
# The kernels multiply variances by squares of metres and by 1e9; nothing real comes near this.
_LARGEST_VARIANCE = 1e12


class PoseTrack:
    """A queue of poses in order of time."""

    def __init__(self, gap_max_ns: int) -> None:
        self._gap_max_ns = gap_max_ns
        self._poses: deque[UncertainPose] = deque()
        self.out_of_order = 0

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest pose."""
        return self._poses[-1].t_ns if self._poses else None

    def add(self, sample: PoseSample) -> bool:
        """Take a pose; one that is not newer than the last is left out, counted, and False.

        Raises:
            MappingError: a number is not finite, or it is no pose or no covariance.
        """
        pose = _uncertain_pose(sample)
        if self._poses and pose.t_ns <= self._poses[-1].t_ns:
            self.out_of_order += 1
            return False
        self._poses.append(pose)
        self._forget_before(pose.t_ns - _HISTORY_NS)
        return True

    def at(self, t_ns: int) -> UncertainPose | None:
        """Return the pose at `t_ns`, or None where no two poses close enough surround it.

        Poses older than the one before `t_ns` are forgotten: ask in order of time.
        """
        if not self._poses or t_ns > self._poses[-1].t_ns:
            return None
        self._forget_before(t_ns)
        before = self._poses[0]
        if before.t_ns == t_ns:
            return before
        if before.t_ns > t_ns or self._poses[1].t_ns - before.t_ns > self._gap_max_ns:
            return None
        return interpolate_pose(before, self._poses[1], t_ns)

    def _forget_before(self, t_ns: int) -> None:
        """Keep the last pose at or before `t_ns` and all behind it."""
        while len(self._poses) > 1 and self._poses[1].t_ns <= t_ns:
            self._poses.popleft()


def _uncertain_pose(sample: PoseSample) -> UncertainPose:
    covariance = sample.covariance
    # A NaN fails both comparisons.
    sound = np.abs(covariance).max() <= _LARGEST_VARIANCE and covariance.diagonal().min() >= 0.0
    if not sound:
        raise MappingError(
            f"pose at {sample.t_ns} ns has a covariance with a negative variance or a number that "
            f"is not finite or above {_LARGEST_VARIANCE:g}; expected m^2 and rad^2"
        )
    try:
        transform = RigidTransform.from_quat_wxyz(sample.position_m, sample.quat_wxyz)
    except MappingError as error:
        raise MappingError(f"pose at {sample.t_ns} ns: {error}") from error
    return UncertainPose(sample.t_ns, transform, covariance)
