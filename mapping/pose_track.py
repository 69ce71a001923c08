"""The poses of the tracked body, and the one at the time of a depth frame."""

from __future__ import annotations

from collections import deque

import numpy as np

from drivers.samples import PoseSample
from mapping.errors import MappingError
from mapping.geometry import RigidTransform, UncertainPose, interpolate_pose


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

    def add(self, sample: PoseSample) -> None:
        """Take a pose; one that is not newer than the last is left out and counted.

        Raises:
            MappingError: a number is not finite.
        """
        numbers = (sample.position_m, sample.quat_wxyz, sample.covariance)
        if not all(np.isfinite(array).all() for array in numbers):
            raise MappingError(f"pose at {sample.t_ns} ns has a NaN or infinite number")
        if self._poses and sample.t_ns <= self._poses[-1].t_ns:
            self.out_of_order += 1
            return
        transform = RigidTransform.from_quat_wxyz(sample.position_m, sample.quat_wxyz)
        self._poses.append(UncertainPose(sample.t_ns, transform, sample.covariance))

    def at(self, t_ns: int) -> UncertainPose | None:
        """Return the pose at `t_ns`, or None where no two poses close enough surround it.

        Poses older than the one before `t_ns` are forgotten: ask in order of time.
        """
        while len(self._poses) > 1 and self._poses[1].t_ns <= t_ns:
            self._poses.popleft()
        if not self._poses or self._poses[0].t_ns > t_ns:
            return None
        before = self._poses[0]
        if before.t_ns == t_ns:
            return before
        if len(self._poses) == 1 or self._poses[1].t_ns - before.t_ns > self._gap_max_ns:
            return None
        return interpolate_pose(before, self._poses[1], t_ns)
