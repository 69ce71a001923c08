"""The poses of a run as motions from one to the next, for what moving does to the map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapping.geometry import UncertainPose
from mapping.motion.relative import RelativeMotion, yaw_of
from mapping.poses.source import PoseSource

Float64Array = NDArray[np.float64]

# A motion is told when the rover has gone this far or turned this much, or after this time:
# poses tremble by millimetres at rest, and a sum of trembles is no way.
_STEP_M = 0.05
_STEP_RAD = 0.05
_STEP_NS = 1_000_000_000
# Without depth frames for so long, in stream time, motions are told all the same: the filter
# forgets its states after a few seconds.
_OVERDUE_NS = 2_500_000_000


class MotionTracker:
    """Makes motions of poses.

    Args:
        poses: asked for the covariance of each motion.
        with_covariance: whether every motion's is wanted; otherwise only those of motions that
            `step` is told to be free, zeros for the others.
        told: pose at the end of the last motion of the run before, if there is one.

    Attributes:
        told: pose at the end of the last motion; before the first one, where it will begin.
    """

    def __init__(
        self, poses: PoseSource, *, with_covariance: bool, told: UncertainPose | None = None
    ) -> None:
        self._poses = poses
        self._with_covariance = with_covariance
        self.told = told
        # The clock of another recording may be behind that of the run before.
        self._new_clock = told is not None
        self._was_free = False

    def is_overdue(self, now_ns: int) -> bool:
        """Tell whether it is long since the last motion."""
        return self.told is not None and now_ns - self.told.t_ns > _OVERDUE_NS

    def step(self, pose: UncertainPose, *, is_free: bool = False) -> RelativeMotion | None:
        """Return the motion since the last one; None while it is too short to be told.

        Args:
            pose: of the rover now.
            is_free: a map that holds other poses does not hold this one.
        """
        last, new_clock = self.told, self._new_clock
        self._new_clock = False
        if last is None:
            self.told = pose
            return None
        self._was_free |= is_free
        way_m = float(np.linalg.norm(pose.transform.translation_m - last.transform.translation_m))
        turn_rad = yaw_of(last.transform.inverse() @ pose.transform)
        moved = way_m >= _STEP_M or abs(turn_rad) >= _STEP_RAD
        since_ns = pose.t_ns - last.t_ns
        if since_ns <= 0 and not new_clock:
            return None
        if not (moved or abs(since_ns) >= _STEP_NS):
            return None
        self.told = pose
        covariance = np.zeros((4, 4))
        if self._with_covariance or self._was_free:
            covariance = self._poses.motion_covariance(last, pose)
        self._was_free = is_free
        return RelativeMotion(
            t_ns=pose.t_ns,
            position_m=pose.transform.translation_m,
            yaw_rad=0.0,
            covariance=covariance,
            distance_m=way_m if way_m >= _STEP_M else 0.0,
        )
