"""Poses that the stream itself holds: motion capture, or an imported trajectory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from acquisition.messages.codec import Recordable
from acquisition.messages.frames import MOCAP_BODY_FRAME
from drivers.samples import PoseSample
from mapping.alignment.scan_to_map import Alignment
from mapping.geometry import UncertainPose
from mapping.pose_track import PoseTrack
from mapping.poses.source import PoseCounts

Float64Array = NDArray[np.float64]


class RecordedPoses:
    """Interpolates between recorded poses.

    Args:
        gap_max_s: longest time between two poses to interpolate across.
    """

    body_frame = MOCAP_BODY_FRAME
    hears_map = False

    def __init__(self, gap_max_s: float) -> None:
        self._gap_max_s = gap_max_s
        self._track = PoseTrack(round(gap_max_s * 1e9))
        self.counts = PoseCounts()

    def add(self, sample: Recordable) -> None:
        """Take a pose; every other sample says nothing.

        Raises:
            MappingError: it is no pose or has no covariance.
        """
        if isinstance(sample, PoseSample):
            self.counts.poses += self._track.add(sample)
            self.counts.out_of_order = self._track.out_of_order

    def finish(self) -> None:
        """Do nothing: a pose is as good as it ever was."""

    def is_ready(self, t_ns: int) -> bool:
        """Tell whether a pose at or after that time has come."""
        newest_ns = self._track.newest_ns
        return newest_ns is not None and newest_ns >= t_ns

    def at(self, t_ns: int) -> UncertainPose | None:
        """Return the pose at a time; None where no two poses close enough surround it."""
        return self._track.at(t_ns)

    @property
    def latest(self) -> None:
        """None: recorded poses are as good after a way as before it."""

    def motion_covariance(
        self,
        before: UncertainPose,  # noqa: ARG002 - part of the protocol
        after: UncertainPose,  # noqa: ARG002
    ) -> Float64Array:
        """Return zeros: no pose hangs on the one before it."""
        return np.zeros((4, 4))

    def correct(self, alignment: Alignment) -> None:
        """Do nothing: recorded poses stay what they are."""

    def why_nothing(self, frames: int) -> str:
        """Say why none of so many depth frames has a pose."""
        if self.counts.poses == 0:
            return (
                f"the stream holds {frames} depth frames but no pose; record motion capture, "
                "import with a trajectory, or map with --pose-source ego-motion+alignment"
            )
        return (
            f"none of {frames} depth frames lies between two of the {self.counts.poses} poses "
            f"within {self._gap_max_s} s; check that both use the same clock"
        )
