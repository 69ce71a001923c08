"""Poses from ego-motion: vibration sensor, gyro and wheels, corrected by what the map says."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from acquisition.messages.codec import Recordable
from acquisition.messages.frames import BASE_FRAME
from drivers.samples import (
    AccelerationSample,
    VibrationSample,
    WheelTwistSample,
    YawRateSample,
)
from mapping.alignment.scan_to_map import Alignment
from mapping.ego_motion.ego_motion import EgoMotion
from mapping.ego_motion.settings import EgoMotionSettings
from mapping.errors import MappingError
from mapping.geometry import UncertainPose
from mapping.motion.relative import upright_covariance
from mapping.poses.settings import TiltSource
from mapping.poses.source import PoseCounts

Float64Array = NDArray[np.float64]

# Between two runs the rover stands: it may roll, settle or be turned by this much, unseen.
_RESTART_SIGMA_M, _RESTART_SIGMA_RAD = 0.02, math.radians(1.0)


class EstimatedPoses:
    """Poses of base_link; T has its origin and heading where the first stream began.

    Args:
        settings: of ego-motion.
        tilt_source: what roll and pitch are known from; "level" needs no acceleration.
        aligned: whether the map will be heard: it can tell place and heading by itself.
        start: where the run before ended, and the rover still stands; None = in T's origin.
    """

    body_frame = BASE_FRAME
    hears_map = True

    def __init__(
        self,
        settings: EgoMotionSettings,
        tilt_source: TiltSource,
        *,
        aligned: bool,
        start: UncertainPose | None = None,
    ) -> None:
        self._ego = EgoMotion(settings, _rested(start) if start else None)
        self._tilt_source = tilt_source
        self._aligned = aligned
        self._seen: set[type] = set()
        self._is_checked = False

    @property
    def counts(self) -> PoseCounts:
        """What became of the input so far."""
        return PoseCounts(events=len(self._ego.events))

    def add(self, sample: Recordable) -> None:
        """Take a sample of any type; what says nothing about motion passes time.

        Raises:
            MappingError: a mount is no pose.
        """
        if isinstance(sample, VibrationSample) and _is_acceleration(sample):
            self._seen.add(AccelerationSample)
        self._seen.add(type(sample))
        self._ego.add(sample)

    def finish(self) -> None:
        """Let the filter take what it still waited with."""
        self._ego.finish()

    def is_ready(self, t_ns: int) -> bool:
        """Tell whether the filter has passed that time, and its reorder window with it."""
        ready_ns = self._ego.poses_ready_until_ns
        return ready_ns is not None and ready_ns >= t_ns

    def at(self, t_ns: int) -> UncertainPose | None:
        """Return the pose at a time; None before the first sample and behind the last.

        Raises:
            MappingError: the stream lacks a sensor without which no map can be made.
        """
        pose = self._ego.pose_at(t_ns)
        if pose is not None and not self._is_checked:
            self._check()
            self._is_checked = True
        return pose

    @property
    def latest(self) -> UncertainPose | None:
        """The last pose that the filter has found."""
        ready_ns = self._ego.poses_ready_until_ns
        return None if ready_ns is None else self._ego.pose_at(ready_ns)

    def motion_covariance(self, before: UncertainPose, after: UncertainPose) -> Float64Array:
        """Return what the motion adds to the errors of (x, y, z, yaw).

        After a silence longer than the filter's history all of the later pose's error.
        """
        try:
            motion = self._ego.relative_covariance(before.t_ns, after.t_ns)
        except MappingError:
            return upright_covariance(after)
        return motion.covariance_xyz_yaw

    def correct(self, alignment: Alignment) -> None:
        """Take what the map says of a pose that `at` gave.

        The aligner judges its own results; the filter's idea of tilt or speed can be far off and
        sure of it, and leaving the map out then loses both.
        """
        found = alignment.pose
        self._ego.correct(found.t_ns, found.transform, found.covariance, gated=False)

    def why_nothing(self, frames: int) -> str:
        """Say why none of so many depth frames has a pose."""
        if not self._seen & {AccelerationSample, YawRateSample, WheelTwistSample}:
            return (
                f"the stream holds {frames} depth frames but neither accelerations, yaw rates nor "
                "wheels; ego-motion has nothing to go by"
            )
        return (
            f"none of {frames} depth frames lies within the time of the motion sensors; check that "
            "all use the same clock"
        )

    def _check(self) -> None:
        """Refuse what cannot be observed.

        Raises:
            MappingError: names what is missing.
        """
        if self._tilt_source == "levelled" and AccelerationSample not in self._seen:
            raise MappingError(
                "tilt_source is levelled and the stream holds no acceleration; record the "
                'vibration sensor\'s acceleration, or set tilt_source = "level" for ground that is '
                "known to be flat"
            )
        if self._aligned:
            return
        if WheelTwistSample not in self._seen and VibrationSample not in self._seen:
            raise MappingError(
                "the stream holds neither wheels nor vibration: nothing tells how far the rover "
                "went; map with --pose-source ego-motion+alignment"
            )
        if YawRateSample not in self._seen and WheelTwistSample not in self._seen:
            raise MappingError(
                "the stream holds neither a gyro nor wheels: nothing tells the heading; map with "
                "--pose-source ego-motion+alignment"
            )


def _rested(pose: UncertainPose) -> UncertainPose:
    """Return the pose as the beginning of a new run.

    Only what may have happened since is uncertain: the map shares the errors up to there.
    """
    variances = [_RESTART_SIGMA_M**2] * 3 + [_RESTART_SIGMA_RAD**2] * 3
    return replace(pose, covariance=np.diag(variances))


def _is_acceleration(sample: VibrationSample) -> bool:
    return sample.statistic == "instantaneous" and sample.quantity == "acceleration"
