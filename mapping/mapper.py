"""The mapper: samples in, in the stream's order; an elevation map out.

Only sensor time enters. Live and offline differ in where the samples come from, not in here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

from acquisition.messages.codec import Recordable
from acquisition.messages.frames import BASE_FRAME, DEPTH_OPTICAL_FRAME, StaticTransforms
from drivers.samples import DepthFrame, PoseSample
from mapping.alignment.localiser import Localiser
from mapping.cells.elevation_map import ElevationMap, read_out
from mapping.cells.grid import CellWindow, Grid, make_grid
from mapping.cells.update_constants import FrameConstants, fusion_constants
from mapping.cells.update_kernels import fuse
from mapping.errors import MappingError
from mapping.frame_readers import FrameReaders
from mapping.geometry import RigidTransform, UncertainPose
from mapping.mapper_counts import MapperCounts as MapperCounts
from mapping.measurement import FrameReducer, View
from mapping.motion.known_frames import KnownFrames
from mapping.motion.ledger import MotionLedger
from mapping.motion.pose_errors import PoseErrorModel
from mapping.motion.read_out import Rover
from mapping.motion.relative import RelativeMotion
from mapping.motion.repeats import Repeats
from mapping.motion.run_state import RunState
from mapping.mounts import MountTree
from mapping.noise import DepthNoiseModel
from mapping.poses.choice import is_aligned, pose_errors_for, pose_source_for
from mapping.poses.frame_covariance import frame_covariance
from mapping.poses.motion import MotionTracker
from mapping.settings import MapSettings
from mapping.undistortion import Undistortion

# A depth frame waits this long, in stream time, for its pose to be known.
_POSE_WAIT_NS = 2_000_000_000


class Mapper:
    """Fuses depth frames, seen from known or estimated poses, into a grid."""

    def __init__(
        self,
        settings: MapSettings,
        noise: DepthNoiseModel,
        grid: Grid | None = None,
        pose_errors: PoseErrorModel | None = None,
        *,
        fallback: DepthNoiseModel | None = None,
        undistortion: Undistortion | None = None,
        on_pose: Callable[[UncertainPose], None] = lambda _: None,
    ) -> None:
        """Start with an empty map, or with a grid that knows cells already.

        Args:
            settings: of the map and its poses.
            noise: of the depth camera; holds within its own range.
            grid: where the cells live, and what their runs have left; None = as the settings want.
            pose_errors: where the poses' errors are counted; None = as suits their source.
            fallback: noise of readings that the settings want and `noise` does not cover;
                None = such readings are not mapped.
            undistortion: what to take off the depth camera's readings.
            on_pose: told the pose of every frame that is mapped.

        Raises:
            MappingError: the ranges of settings and noise model have nothing in common.
        """
        self.settings = settings
        self.pose_errors = pose_errors or pose_errors_for(settings)
        self.counts = MapperCounts()
        self._readers = FrameReaders(settings, noise, fallback, undistortion, self.counts)
        self._on_pose = on_pose
        self._grid = grid or make_grid(settings)
        before = self._grid.run
        wanted = self.pose_errors.motion_covariance
        self._ledger = MotionLedger(
            with_covariance=wanted or is_aligned(settings), before=before.rover.motions
        )
        self._rover_m = before.rover.x_m, before.rover.y_m
        self._last = before.pose
        self._fusion = fusion_constants(settings)
        self._poses = pose_source_for(settings, before.pose)
        self._frames = KnownFrames(before.frames, self.counts, settings.pose_source)
        self._motion: MotionTracker | None = None
        if settings.pose_source != "mocap":
            self._motion = MotionTracker(self._poses, with_covariance=wanted, told=before.told)
        self._mounts = MountTree(self.counts)
        self._repeats = Repeats(jittering=settings.pose_source == "mocap", rest=before.rest)
        self._localiser: Localiser | None = None
        if is_aligned(settings):
            self._localiser = Localiser(
                self._poses,
                self._mounts,
                settings.alignment,
                settings.gravity,
                settings.resolution_m,
            )
            self._localiser.slid_rad = before.slid_rad
        self._waiting: list[DepthFrame] = []

    @property
    def noise(self) -> DepthNoiseModel:
        """Noise model of the depth camera, within the settings' range."""
        return self._readers.noise

    @property
    def undistortion(self) -> Undistortion | None:
        """What is taken off the depth camera's readings; None = nothing."""
        return self._readers.undistortion

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
        if isinstance(sample, DepthFrame) and self._frames.is_new(sample):
            self._waiting.append(sample)
        if self._waiting:
            self._map_ready_frames(sample.t_ns)
        if isinstance(sample, PoseSample | DepthFrame):
            self._count_poses()
        if self._motion is not None and self._motion.is_overdue(sample.t_ns):
            self._follow_latest()

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
        """Map the frames that can be mapped and count the rest; the stream is over.

        Raises:
            MappingError: as `add`, or the grid cannot be saved.
        """
        self._poses.finish()
        waiting, self._waiting = self._waiting, []
        for frame in waiting:
            self._map_or_count(frame)
        self._follow_latest()
        self._count_poses()
        if self.counts.frames > 0:  # else it is an error, which leaves a world as it was
            self._grid.keep(self._run(), at_once=True)

    def elevation_map(self, attributes: dict[str, str | int | float] | None = None) -> ElevationMap:
        """Return the map as it is now, though it may have known all frames before.

        Raises:
            MappingError: nothing has been mapped; the message says why.
        """
        if self.counts.frames + self.counts.frames_known == 0:
            raise MappingError(self._why_nothing())
        return self.read_map(attributes or {})

    def read_map(self, attributes: Mapping[str, str | int | float]) -> ElevationMap:
        """Return the map as it is now, however few frames it has seen.

        Raises:
            MappingError: no reading has reached the map.
        """
        return read_out(self._grid, self.settings, attributes, self._run().rover)

    def _run(self) -> RunState:
        """Return what is known beside the cells, as of now."""
        errors = self.pose_errors
        slid_rad = self._localiser.slid_rad if self._localiser else 0.0
        if slid_rad > 0.0:
            tilt_rad = math.hypot(errors.gravity_sigma_rad, slid_rad)
            errors = replace(errors, gravity_sigma_rad=tilt_rad)
        rover = Rover(*self._rover_m, self._ledger.motions, errors)
        told = self._motion.told if self._motion else None
        return RunState(rover, self._last, told, slid_rad, self._repeats.rest, self._frames.keys)

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
        """One depth frame's walk: readings, pose, motion, footprint, sums per cell, update."""
        self._frames.add(frame)
        reducers = self._readers.of(frame.camera)
        mount = self._mounts.lookup(self.body_frame, DEPTH_OPTICAL_FRAME)
        on_rover = self._mount_on_rover()
        readings = [self._readers.load(reducer, frame, on_rover) for reducer in reducers]
        pose: UncertainPose | None = prior
        if self._localiser is not None:
            pose = self._localiser.refine(reducers[0], prior, mount, self._grid)
        if pose is None:
            return
        self._follow(pose, is_free=self._localiser is not None and not self._localiser.is_held)
        counted = replace(pose, covariance=frame_covariance(pose.covariance, self.pose_errors))
        view = View(counted, pose.transform @ mount)
        farthest = max(reducers, key=lambda reducer: reducer.noise.range_max_m)
        window = self._grid.prepare(farthest.footprint(view), *self._rover_m)
        repeats = self._repeats.count(view.T_terrain_sensor, counted)
        constants = [self._constants(reducer, view, window, repeats) for reducer in reducers]
        sums = [
            self._readers.reduce(reducer, count, view, window, c, self._grid.layers)
            for reducer, count, c in zip(reducers, readings, constants, strict=True)
        ]
        self._readers.look_around(frame, view, sums, constants[0], self._grid.layers)
        for part, c in zip(sums, constants, strict=True):
            result = fuse(part, c, self._fusion, self._grid.layers, self._ledger.motions)
            self.counts.updates += result.cells
            self.counts.rejected += result.rejected
            self.counts.replaced += result.replaced
        self.counts.frames += 1
        self._grid.keep(self._run())
        self._on_pose(pose)

    def _mount_on_rover(self) -> RigidTransform | None:
        """Return where the camera is on the rover, if the rover may be in its view."""
        if not self.settings.body_boxes_m:
            return None
        return self._mounts.lookup(BASE_FRAME, DEPTH_OPTICAL_FRAME)

    def _constants(
        self, reducer: FrameReducer, view: View, window: CellWindow, repeats: int
    ) -> FrameConstants:
        """Return what the update needs to know of this frame, its pose's errors among it."""
        constants = reducer.frame_constants(view, window, self._grid.position(window))
        errors = self.pose_errors
        return constants._replace(
            frame_m2=errors.frame_sigma_m**2,
            frame_rad2=errors.frame_sigma_rad**2,
            drift_per_m=errors.drift_per_m,
            repeats=float(repeats),
        )

    def _follow_latest(self) -> None:
        """Follow the rover though there is no depth."""
        latest = self._poses.latest
        if latest is not None:
            self._follow(latest, is_free=self._localiser is not None)

    def _follow(self, pose: UncertainPose, *, is_free: bool) -> None:
        """Let the map know how the rover has moved, and whether no map held it on the way."""
        motion = self._motion.step(pose, is_free=is_free) if self._motion else None
        if motion is not None:
            self.move(motion)
        x_m, y_m, _ = pose.transform.translation_m.tolist()
        self._rover_m = (x_m, y_m)
        self._last = pose

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
            return "the stream holds no depth frame; nothing can be mapped; see `terravibe info`"
        return self._poses.why_nothing(self.counts.frames_without_pose)
