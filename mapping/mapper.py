"""The mapper: samples in, in the stream's order; an elevation map out.

Only sensor time enters. Live and offline differ in where the samples come from, not in here.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from acquisition.messages.codec import Recordable
from acquisition.messages.frames import DEPTH_OPTICAL_FRAME, StaticTransforms
from drivers.samples import CameraIntrinsics, DepthFrame, PoseSample
from mapping.alignment.localiser import Localiser
from mapping.cells.elevation_map import ElevationMap, read_out
from mapping.cells.grid import make_grid
from mapping.cells.update_constants import fusion_constants
from mapping.cells.update_kernels import fuse
from mapping.errors import MappingError
from mapping.geometry import Float64Array, RigidTransform, UncertainPose
from mapping.measurement import FrameReducer, View
from mapping.motion.ledger import MotionLedger
from mapping.motion.pose_errors import PoseErrorModel
from mapping.motion.read_out import Rover
from mapping.motion.relative import RelativeMotion
from mapping.mounts import MountTree
from mapping.noise import DepthNoiseModel
from mapping.poses.choice import is_aligned, pose_errors_for, pose_source_for
from mapping.poses.motion import MotionTracker
from mapping.settings import MapSettings

# A depth frame waits this long, in stream time, for its pose to be known.
_POSE_WAIT_NS = 2_000_000_000


@dataclass(slots=True)
class MapperCounts:
    """What became of the input.

    Attributes:
        frames: depth frames mapped.
        frames_without_pose: depth frames left out because no pose surrounds their time.
        poses, poses_out_of_order: poses taken; poses left out because they came out of order.
        readings: valid depth readings of the mapped frames.
        readings_outside: readings of them that fell outside the grid.
        updates: cell updates. rejected: those that went to a second hypothesis. replaced: second
            hypotheses that took over.
        motions: relative motions taken. motions_clipped: those whose covariance had a negative
            eigenvalue.
        pose_events: things that estimated poses suffered from.
        aligned, unaligned, misfits, slid: frames whose pose the map corrected; to which it had
            nothing to say; which fitted it nowhere and were not mapped; at which the map's idea
            of gravity was found wrong.
    """

    frames: int = 0
    frames_without_pose: int = 0
    poses: int = 0
    poses_out_of_order: int = 0
    readings: int = 0
    readings_outside: int = 0
    updates: int = 0
    rejected: int = 0
    replaced: int = 0
    motions: int = 0
    motions_clipped: int = 0
    pose_events: int = 0
    aligned: int = 0
    unaligned: int = 0
    misfits: int = 0
    slid: int = 0


class Mapper:
    """Fuses depth frames, seen from known or estimated poses, into a grid."""

    def __init__(
        self,
        settings: MapSettings,
        noise: DepthNoiseModel,
        pose_errors: PoseErrorModel | None = None,
        *,
        on_pose: Callable[[UncertainPose], None] = lambda _: None,
    ) -> None:
        """Start with an empty map.

        Args:
            settings: of the map and its poses.
            noise: of the depth sensor.
            pose_errors: where the poses' errors are counted; None = as suits their source.
            on_pose: told the pose of every frame that is mapped.

        Raises:
            MappingError: the ranges of settings and noise model have nothing in common.
        """
        self.settings = settings
        self.noise = _within_both_ranges(settings, noise)
        self.pose_errors = pose_errors or pose_errors_for(settings)
        self.counts = MapperCounts()
        self._on_pose = on_pose
        self._ledger = MotionLedger(with_covariance=self.pose_errors.motion_covariance)
        self._rover_m = (0.0, 0.0)
        self._grid = make_grid(settings)
        self._fusion = fusion_constants(settings)
        self._poses = pose_source_for(settings)
        absolute = settings.pose_source == "mocap"
        self._motion = None if absolute else MotionTracker(self._poses)
        self._mounts = MountTree()
        self._localiser: Localiser | None = None
        if is_aligned(settings):
            self._localiser = Localiser(
                self._poses,
                self._mounts,
                settings.alignment,
                settings.gravity,
                settings.resolution_m,
            )
        self._waiting: list[DepthFrame] = []
        self._reducer: FrameReducer | None = None

    @property
    def body_frame(self) -> str:
        """Name of the frame whose poses the map is made with."""
        return self._poses.body_frame

    def add(self, sample: Recordable) -> None:
        """Take the next sample of the stream, of whatever type.

        Raises:
            MappingError: the mount is missing, a pose or mount is no pose, a depth image does not
                fit its camera, the stream lacks a sensor that the pose source lives on, or the map
                outgrows memory.
        """
        if isinstance(sample, StaticTransforms):
            self._mounts.add(sample.transforms)
        self._poses.add(sample)
        if self._localiser is not None:
            self._localiser.add(sample)
        if isinstance(sample, DepthFrame):
            self._waiting.append(sample)
        if self._waiting:
            self._map_ready_frames(sample.t_ns)
        if isinstance(sample, PoseSample | DepthFrame):
            self._count_poses()

    def move(self, motion: RelativeMotion) -> None:
        """Take the rover's motion since the last one, with or without depth in between.

        Call it before the frame at the motion's end is mapped. Heights do not move; the cells'
        places relative to the rover become uncertain, as `pose_errors` says.

        Raises:
            MappingError: a number is not finite, or the way is negative.
        """
        self._ledger.add(motion)
        self._rover_m = (float(motion.position_m[0]), float(motion.position_m[1]))
        self.counts.motions += 1
        self.counts.motions_clipped = self._ledger.clipped

    def finish(self) -> None:
        """Map the frames that can be mapped and count the rest; the stream is over."""
        self._poses.finish()
        waiting, self._waiting = self._waiting, []
        for frame in waiting:
            self._map_or_count(frame)
        latest = self._poses.latest
        if latest is not None:
            self._follow(latest)
        self._count_poses()

    def elevation_map(self, attributes: dict[str, str | int | float] | None = None) -> ElevationMap:
        """Return the map as it is now.

        Raises:
            MappingError: nothing has been mapped; the message says why.
        """
        if self.counts.frames == 0:
            raise MappingError(self._why_nothing())
        errors = self.pose_errors
        if self._localiser is not None and self._localiser.slid_rad > 0.0:
            tilt_rad = math.hypot(errors.gravity_sigma_rad, self._localiser.slid_rad)
            errors = replace(errors, gravity_sigma_rad=tilt_rad)
        rover = Rover(*self._rover_m, self._ledger.motions, errors)
        return read_out(self._grid, self.settings, attributes or {}, rover)

    def _map_ready_frames(self, now_ns: int) -> None:
        """Map waiting frames whose pose is final, or that have waited long enough.

        Each frame waits for itself: one with a stamp in the future holds up no other.
        """
        waiting, self._waiting = self._waiting, []
        for frame in waiting:
            if self._poses.is_ready(frame.t_ns) or now_ns - frame.t_ns > _POSE_WAIT_NS:
                self._map_or_count(frame)
            else:
                self._waiting.append(frame)

    def _map_or_count(self, frame: DepthFrame) -> None:
        pose = self._poses.at(frame.t_ns)
        if pose is None:
            self.counts.frames_without_pose += 1
        else:
            self._map(frame, pose)

    def _map(self, frame: DepthFrame, prior: UncertainPose) -> None:
        """One depth frame's walk: readings, pose, motion, sums per cell, update."""
        reducer = self._reducer_for(frame.camera)
        mount = self._mounts.lookup(self._poses.body_frame, DEPTH_OPTICAL_FRAME)
        readings = reducer.load(frame.depth_mm)
        pose: UncertainPose | None = prior
        if self._localiser is not None:
            pose = self._localiser.refine(reducer, prior, mount, self._grid)
        if pose is None:
            return
        self._follow(pose)
        self._fuse(reducer, pose, mount, readings)
        self._on_pose(pose)

    def _follow(self, pose: UncertainPose) -> None:
        """Let the map know how the rover has moved."""
        motion = self._motion.step(pose) if self._motion else None
        if motion is not None:
            self.move(motion)
        x_m, y_m, _ = pose.transform.translation_m.tolist()
        self._rover_m = (x_m, y_m)

    def _fuse(
        self, reducer: FrameReducer, pose: UncertainPose, mount: RigidTransform, readings: int
    ) -> None:
        pose = replace(pose, covariance=self._counted_per_frame(pose.covariance))
        view = View(pose, pose.transform @ mount)
        window = self._grid.prepare(reducer.footprint(view), *self._rover_m)
        sums, inside = reducer.reduce(view, window)
        constants = reducer.frame_constants(view, window, self._grid.position(window))
        result = fuse(sums, constants, self._fusion, self._grid.layers, self._ledger.motions)
        self.counts.frames += 1
        self.counts.readings += readings
        self.counts.readings_outside += readings - inside
        self.counts.updates += result.cells
        self.counts.rejected += result.rejected
        self.counts.replaced += result.replaced

    def _counted_per_frame(self, covariance: Float64Array) -> Float64Array:
        """Return the covariance (6, 6) that a frame's measurements carry for their pose.

        What is counted at read-out still weighs here: without it near readings, which are the
        best, would overrule all that was seen from afar, and a map that remembers nothing but the
        last frames lets aligned poses drift (23 mm instead of 3 on a smooth drive). Of poses whose
        motions count, only the tilt is left, which levelling finds anew.
        """
        errors = self.pose_errors
        if errors.pose_covariance and not errors.motion_covariance:
            return covariance
        variances = [errors.frame_sigma_m**2, errors.frame_sigma_rad**2, errors.frame_sigma_rad**2]
        counted = np.diag([0.0, 0.0, *variances, 0.0])
        if errors.pose_covariance:
            counted[3:5, 3:5] = covariance[3:5, 3:5]
        return counted

    def _reducer_for(self, camera: CameraIntrinsics) -> FrameReducer:
        if self._reducer is None or self._reducer.camera != camera:
            self._reducer = FrameReducer(camera, self.noise, self.settings)
        return self._reducer

    def _count_poses(self) -> None:
        """Copy the counts of those that count for themselves."""
        poses = self._poses.counts
        self.counts.poses, self.counts.poses_out_of_order = poses.poses, poses.out_of_order
        self.counts.pose_events = poses.events
        if self._localiser is not None:
            found = self._localiser.counts
            self.counts.aligned, self.counts.unaligned = found.aligned, found.unaligned
            self.counts.misfits, self.counts.slid = found.misfits, found.slid

    def _why_nothing(self) -> str:
        if self.counts.frames_without_pose == 0:
            return "the stream holds no depth frame; nothing can be mapped"
        return self._poses.why_nothing(self.counts.frames_without_pose)


def _within_both_ranges(settings: MapSettings, noise: DepthNoiseModel) -> DepthNoiseModel:
    range_min_m = max(noise.range_min_m, settings.range_min_m)
    range_max_m = min(noise.range_max_m, settings.range_max_m)
    if range_min_m >= range_max_m:
        raise MappingError(
            f"the settings map {settings.range_min_m} to {settings.range_max_m} m and noise model "
            f"{noise.name!r} covers {noise.range_min_m} to {noise.range_max_m} m; expected ranges "
            "that overlap"
        )
    return noise.with_range(range_min_m, range_max_m)
