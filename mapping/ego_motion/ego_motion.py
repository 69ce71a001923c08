"""Where the rover is: samples in, in whatever order they arrive; poses with covariances out."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from acquisition.messages.codec import Recordable
from acquisition.messages.frames import BASE_FRAME, MOCAP_BODY_FRAME, StaticTransforms
from drivers.samples import PoseSample
from mapping.ego_motion.events import EgoEvent
from mapping.ego_motion.filter import PoseFilter, PoseMeasurement
from mapping.ego_motion.front_end import FrontEnd
from mapping.ego_motion.intake import Intake, Reading
from mapping.ego_motion.relative import RelativeMotion, relative_motion
from mapping.ego_motion.settings import EgoMotionSettings
from mapping.ego_motion.tilt import from_pose, rotation_jacobian, to_pose
from mapping.errors import MappingError
from mapping.geometry import Float64Array, RigidTransform, UncertainPose
from mapping.mounts import MountTree

# The filter runs for at least so much new time at once.
_BATCH_NS = 50_000_000
# A stamp so far ahead of all others is taken for nonsense, unless many follow.
_JUMP_NS = 10_000_000_000
_JUMP_PATIENCE = 50
# Before an external pose, nothing is known of the place.
_ANYWHERE_M = 1e4


class EgoMotion:
    """Ego-motion of base_link in T.

    T has its origin and heading at the start, unless `start` or external poses say otherwise;
    its z axis is up. Only sensor time counts: the same samples give the same poses, however their
    arrival was mixed within the reorder window.

    Args:
        settings: what is assumed of sensors and vehicle.
        start: pose of base_link at the first sample; its roll and pitch are levelled anew.
    """

    def __init__(
        self, settings: EgoMotionSettings | None = None, start: UncertainPose | None = None
    ) -> None:
        self.settings = settings or EgoMotionSettings()
        self._start = start
        self._mounts = MountTree()
        self._front = FrontEnd(self.settings)
        self._intake = Intake(self.settings, self._mounts, self._front)
        self._filter: PoseFilter | None = None
        self._early: list[PoseMeasurement] = []
        self._newest_ns: int | None = None
        self._first_ns: int | None = None
        self._processed_ns = 0
        self._jumps = 0
        self._has_place = not self.settings.use_external_poses

    @property
    def events(self) -> Sequence[EgoEvent]:
        """What went wrong so far, in the order in which it was noticed."""
        return self._front.watch.events

    @property
    def poses_ready_until_ns(self) -> int | None:
        """The last time for which `pose_at` has an answer that more samples will not change."""
        return self._filter.newest_ns if self._filter else None

    def add(self, sample: Recordable) -> None:
        """Take the next sample of the stream; what says nothing about motion only passes time.

        Raises:
            MappingError: a mount is no pose, or external poses cannot be related to base_link.
        """
        if isinstance(sample, StaticTransforms):
            self._mounts.add(sample.transforms)
            self._intake.forget_mounts()
            return
        reading = self._intake.reading(sample)
        if reading is None and self._first_ns is None and not isinstance(sample, PoseSample):
            return
        if not self._see(sample.t_ns):
            return
        if reading is not None:
            self._take(reading)
        elif isinstance(sample, PoseSample) and self.settings.use_external_poses:
            self._add_pose(sample)
        if self._newest_ns is not None:
            self._run(self._newest_ns - round(1e9 * self.settings.reorder_window_s))

    def finish(self) -> None:
        """Find the poses up to the last sample; the stream is over."""
        if self._newest_ns is not None:
            self._run(self._newest_ns, last=True)

    def pose_at(self, t_ns: int) -> UncertainPose | None:
        """Return the pose of base_link; None before the history and after the ready poses."""
        if self._filter is None or not self._filter.oldest_ns <= t_ns <= self._filter.newest_ns:
            return None
        found = self._filter.at(t_ns)
        return to_pose(t_ns, found.vector, found.covariance)

    def correct(
        self,
        t_ns: int,
        pose: RigidTransform,
        covariance: Float64Array,
        *,
        gated: bool = True,
    ) -> bool:
        """Take an external pose of base_link in T, such as an alignment with the map.

        It is put where it belongs in time; all poses since then change.

        Args:
            t_ns: its time.
            pose: T_TR.
            covariance: (6, 6) of (x, y, z, rotation about T's x, y, z): m^2, m rad, rad^2.
            gated: leave it out when it is too unlikely; False for a source that judges itself.

        Returns:
            False when it was too unlikely or too old and was left out.
        """
        return self._correct(t_ns, pose, covariance, gated=gated)

    def relative_covariance(self, t0_ns: int, t1_ns: int) -> RelativeMotion:
        """Return the motion from one time to a later one, with its covariance.

        Raises:
            MappingError: one of the times is not among the states that are kept.
        """
        filter_ = self._filter
        if filter_ is None or not filter_.oldest_ns <= t0_ns <= t1_ns <= filter_.newest_ns:
            kept = f"{filter_.oldest_ns} to {filter_.newest_ns} ns" if filter_ else "nothing yet"
            raise MappingError(
                f"no motion from {t0_ns} to {t1_ns} ns; expected times in order within {kept}; "
                "raise history_s or ask sooner"
            )
        ends = filter_.at(t0_ns), filter_.at(t1_ns)
        jacobian = np.eye(12)
        for at, end in zip((3, 9), ends, strict=True):
            jacobian[at : at + 3, at : at + 3] = rotation_jacobian(*end.vector[4:])
        joint = jacobian @ filter_.joint(*ends) @ jacobian.T
        poses = [to_pose(end.t_ns, end.vector, end.covariance).transform for end in ends]
        return relative_motion((t0_ns, t1_ns), poses[0], poses[1], joint)

    def _run(self, until_ns: int, *, last: bool = False) -> None:
        """Let the filter take what has become certain."""
        if self._first_ns is None or (until_ns < self._processed_ns + _BATCH_NS and not last):
            return
        if until_ns < self._first_ns and not last:
            return
        filter_ = self._filter = self._filter or self._begin(self._first_ns)
        self._processed_ns = until_ns
        for batch in self._front.rows(until_ns, last=last):
            self._front.watch.surprise(filter_.advance(*batch))

    def _begin(self, t_ns: int) -> PoseFilter:
        """Return a filter whose first state is just before the first tick."""
        self._front.begin(t_ns)
        vector, covariance = np.zeros(6), np.zeros((6, 6))
        if self._start is not None:
            vector, covariance = from_pose(self._start.transform, self._start.covariance)
        elif self.settings.use_external_poses:
            covariance = np.diag([_ANYWHERE_M**2] * 3 + [math.pi**2] * 3)
        first_ns = self._front.first_tick_ns - 1
        new = PoseFilter(self.settings, first_ns, vector, covariance)
        for pose in self._early:
            new.correct(pose)
        self._early.clear()
        return new

    def _correct(
        self, t_ns: int, pose: RigidTransform, covariance: Float64Array, *, gated: bool
    ) -> bool:
        vector, euler = from_pose(pose, covariance)
        floor = [self.settings.position_floor_m**2] * 3 + [self.settings.rotation_floor_rad**2] * 3
        measurement = PoseMeasurement(t_ns, vector, euler + np.diag(floor), gated)
        if self._filter is None:
            self._early.append(measurement)
            return True
        surprises = self._filter.correct(measurement)
        if surprises is None:
            self._late(t_ns, "an external pose")
            return False
        self._front.watch.surprise(surprises)
        return not surprises

    def _see(self, t_ns: int) -> bool:
        """Follow stream time; False for a stamp that cannot be."""
        if self._newest_ns is not None and t_ns > self._newest_ns + _JUMP_NS:
            self._jumps += 1
            if self._jumps < _JUMP_PATIENCE:
                text = f"a stamp {(t_ns - self._newest_ns) * 1e-9:.0f} s ahead; left out"
                self._front.watch.tell(self._newest_ns, "clock_jump", text)
                return False
        self._jumps = 0
        if self._newest_ns is None or t_ns > self._newest_ns:
            self._newest_ns = t_ns
        return True

    def _take(self, reading: Reading) -> None:
        """Put a measurement of motion where it belongs."""
        queue, t_ns, values, what = reading
        if not all(map(math.isfinite, values)):
            text = f"{what} holds a number that is not finite; left out"
            self._front.watch.tell(t_ns, "bad_sample", text)
            return
        if self._filter is None:
            self._first_ns = t_ns if self._first_ns is None else min(t_ns, self._first_ns)
        if not queue.add(t_ns, values):
            self._late(t_ns, what)

    def _late(self, t_ns: int, what: str) -> None:
        text = f"{what} came later than the reorder window allows; left out"
        self._front.watch.tell(t_ns, "late_sample", text)

    def _add_pose(self, sample: PoseSample) -> None:
        body = RigidTransform.from_quat_wxyz(sample.position_m, sample.quat_wxyz)
        base = body @ self._mounts.lookup(MOCAP_BODY_FRAME, BASE_FRAME)
        self._correct(sample.t_ns, base, sample.covariance, gated=self._has_place)
        self._has_place = True
