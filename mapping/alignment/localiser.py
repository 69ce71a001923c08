"""A frame's pose, held against the map and against gravity, before the frame is mapped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition.messages.codec import Recordable
from mapping.alignment.felt_gravity import FeltGravity
from mapping.alignment.fusion import fuse_pose, pose_difference
from mapping.alignment.gravity import GravityCheck, GravitySettings
from mapping.alignment.observability import metres_per_unit
from mapping.alignment.scan_to_map import Alignment, ScanAligner
from mapping.alignment.settings import AlignmentSettings
from mapping.cells.grid import Grid
from mapping.geometry import RigidTransform, UncertainPose
from mapping.measurement import FrameReducer, View
from mapping.mounts import MountTree
from mapping.poses.source import PoseSource


@dataclass(slots=True)
class AlignmentCounts:
    """What became of the frames that were to be aligned.

    Attributes:
        aligned: frames whose pose the map has corrected.
        unaligned: frames to which the map had nothing to say: the first one, new ground, a void.
        misfits: frames that fit the map nowhere near their prior; the first of them in a row are
            not mapped.
        slid: frames at which the map's idea of gravity was found wrong.
    """

    aligned: int = 0
    unaligned: int = 0
    misfits: int = 0
    slid: int = 0


class Localiser:
    """Aligns each frame with the map and tells the pose source.

    Args:
        poses: where the prior comes from.
        mounts: of the stream; filled while it goes on.
        settings, gravity: of alignment and gravity check.
        cell_size_m: of the map.

    Attributes:
        counts: what became of the frames.
        slid_rad: by how much the map was found to lean, at most.
        is_held: whether the map has corrected the last frame's pose.
    """

    def __init__(
        self,
        poses: PoseSource,
        mounts: MountTree,
        settings: AlignmentSettings,
        gravity: GravitySettings,
        cell_size_m: float,
    ) -> None:
        self.counts = AlignmentCounts()
        self.slid_rad = 0.0
        self.is_held = False
        self._misfits_in_a_row = 0
        self._poses = poses
        self._settings = settings
        self._aligner = ScanAligner(settings, cell_size_m)
        self._felt = FeltGravity(mounts, poses.body_frame)
        self._check = GravityCheck(gravity)

    def add(self, sample: Recordable) -> None:
        """Take the next sample of the stream."""
        self._felt.add(sample)

    def refine(
        self, reducer: FrameReducer, prior: UncertainPose, mount: RigidTransform, grid: Grid
    ) -> UncertainPose | None:
        """Return the pose of the loaded frame; None where it must not be mapped.

        Args:
            reducer: has the frame loaded.
            prior: pose of the tracked body at the frame's time.
            mount: T_body_sensor.
            grid: the map of the frames before.
        """
        before = self.counts.aligned
        pose = self._aligned(reducer, prior, mount, grid)
        self.is_held = self.counts.aligned > before
        if pose is not None:
            self._hold_against_gravity(pose)
        return pose

    def _aligned(
        self, reducer: FrameReducer, prior: UncertainPose, mount: RigidTransform, grid: Grid
    ) -> UncertainPose | None:
        alignment = self._aligner.align(reducer, View(prior, prior.transform @ mount), grid)
        if alignment is None:
            self.counts.unaligned += 1
            return prior
        if not self._is_credible(alignment, prior):
            self.counts.misfits += 1
            self._misfits_in_a_row += 1
            return prior if self._misfits_in_a_row > self._settings.most_misfits else None
        self._misfits_in_a_row = 0
        self.counts.aligned += 1
        self._poses.correct(alignment)
        hears_map = self._poses.hears_map
        return fuse_pose(prior, alignment, self._settings, hears_map=hears_map)

    def _is_credible(self, alignment: Alignment, prior: UncertainPose) -> bool:
        """Tell whether the frame fits the map, at a place not far from the prior's."""
        unit = metres_per_unit(self._settings)
        way = pose_difference(alignment.pose.transform, prior.transform) * unit
        near = float(np.linalg.norm(way)) <= self._settings.farthest_m
        return near and alignment.sigma_scale <= self._settings.worst_scale

    def _hold_against_gravity(self, pose: UncertainPose) -> None:
        up = self._felt.up_until(pose.t_ns)
        if up is not None:
            slid_rad = self._check.add(pose.t_ns, up, pose.transform.rotation)
            self.counts.slid += slid_rad > 0.0
            self.slid_rad = max(self.slid_rad, slid_rad)
