"""The mapper: samples in, in the stream's order; an elevation map out.

Only sensor time enters. Live and offline differ in where the samples come from, not in here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from acquisition.messages.codec import Recordable
from acquisition.messages.frames import BASE_FRAME, DEPTH_OPTICAL_FRAME, StaticTransforms
from drivers.samples import CameraIntrinsics, DepthFrame, PoseSample
from mapping.alignment.localiser import Localiser
from mapping.cells.elevation_map import ElevationMap, read_out
from mapping.cells.grid import CellWindow, Grid, make_grid
from mapping.cells.update_constants import FrameConstants, fusion_constants
from mapping.cells.update_kernels import fuse
from mapping.change.hidden import mark_hidden
from mapping.change.overhang import drop_overhangs
from mapping.change.own_body import drop_own_body
from mapping.change.visibility import clear_seen_through, sight_of
from mapping.errors import MappingError
from mapping.geometry import UncertainPose
from mapping.mapper_counts import MapperCounts as MapperCounts
from mapping.measurement import Float64Array, FrameReducer, View
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

FloatArray = TypeVar("FloatArray", NDArray[np.float32], NDArray[np.float64])

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
            grid: where the cells live, and what is known of the runs that they are from; None =
                an empty one, as the settings want.
            pose_errors: where the poses' errors are counted; None = as suits their source.
            fallback: noise of readings that the settings want and `noise` does not cover;
                None = such readings are not mapped.
            undistortion: what to take off the depth camera's readings.
            on_pose: told the pose of every frame that is mapped.

        Raises:
            MappingError: the ranges of settings and noise model have nothing in common.
        """
        self.settings = settings
        self.noise = _within_both_ranges(settings, noise)
        self.undistortion = undistortion
        self.pose_errors = pose_errors or pose_errors_for(settings)
        self.counts = MapperCounts()
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
        self._motion: MotionTracker | None = None
        if settings.pose_source != "mocap":
            self._motion = MotionTracker(self._poses, with_covariance=wanted, told=before.told)
        self._mounts = MountTree()
        self._repeats = Repeats(jittering=settings.pose_source == "mocap")
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
        self._fallbacks = _around(self.noise, settings, fallback)
        self._reducers: list[FrameReducer] = []

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
        self._grid.keep(self._run(), at_once=True)

    def elevation_map(self, attributes: dict[str, str | int | float] | None = None) -> ElevationMap:
        """Return the map as it is now.

        Raises:
            MappingError: nothing has been mapped; the message says why.
        """
        if self.counts.frames == 0:
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
        return RunState(rover, self._last, told, slid_rad)

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
        reducers = self._reducers_for(frame.camera)
        mount = self._mounts.lookup(self.body_frame, DEPTH_OPTICAL_FRAME)
        readings = [self._load(reducer, frame) for reducer in reducers]
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
            self._reduce(reducer, count, view, window, c)
            for reducer, count, c in zip(reducers, readings, constants, strict=True)
        ]
        self._look_around(frame, view, _together(sums), constants[0])
        for part, c in zip(sums, constants, strict=True):
            result = fuse(part, c, self._fusion, self._grid.layers, self._ledger.motions)
            self.counts.updates += result.cells
            self.counts.rejected += result.rejected
            self.counts.replaced += result.replaced
        self.counts.frames += 1
        self._grid.keep(self._run())
        self._on_pose(pose)

    def _load(self, reducer: FrameReducer, frame: DepthFrame) -> int:
        """Take a frame's readings; return how many are left without those of the rover itself."""
        return reducer.load(frame.depth_mm) - self._drop_own_body(reducer)

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

    def _reduce(
        self,
        reducer: FrameReducer,
        readings: int,
        view: View,
        window: CellWindow,
        constants: FrameConstants,
    ) -> Float64Array:
        """Return the sums over the window of the readings that a reducer took."""
        readings -= self._drop_overhangs(reducer, view, constants)
        sums, inside = reducer.reduce(view, window)
        self.counts.readings += readings
        self.counts.readings_outside += readings - inside
        if reducer is not self._reducers[0]:
            self.counts.readings_uncalibrated += readings
        return sums[: window.cells_x * window.cells_y]

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

    def _drop_own_body(self, reducer: FrameReducer) -> int:
        """Drop what hits the rover itself; return how many readings."""
        if not self.settings.body_boxes_m:
            return 0
        mount = self._mounts.lookup(BASE_FRAME, DEPTH_OPTICAL_FRAME)
        dropped = drop_own_body(reducer.readings, self.settings.body_boxes_m, mount)
        self.counts.readings_own_body += dropped
        return dropped

    def _drop_overhangs(self, reducer: FrameReducer, view: View, constants: FrameConstants) -> int:
        """Drop what hangs high above the ground; return how many readings."""
        if self.settings.overhang_clearance_m == 0.0:
            return 0
        layers = self._grid.layers
        dropped = drop_overhangs(reducer.readings, view, constants, layers, self.settings)
        self.counts.readings_overhanging += dropped
        return dropped

    def _look_around(
        self, frame: DepthFrame, view: View, sums: Float64Array, constants: FrameConstants
    ) -> None:
        """Forget cells that frames have looked through; mark those that are hidden from this."""
        limit = self.settings.seen_through_frames
        if limit:
            layers = self._grid.layers
            sight = sight_of(frame.camera, self.noise, view, limit)
            self.counts.cleared += clear_seen_through(
                frame.depth_mm, sums, constants, sight, layers
            )
            whole = _together([reducer.readings.z_m for reducer in self._reducers])
            readings = self._reducers[0].readings._replace(z_m=whole)
            mark_hidden(readings, view, constants, sight, layers.hidden)

    def _reducers_for(self, camera: CameraIntrinsics) -> list[FrameReducer]:
        if not self._reducers or self._reducers[0].camera != camera:
            noises = [self.noise, *self._fallbacks]
            self._reducers = [
                FrameReducer(camera, noise, self.settings, self.undistortion) for noise in noises
            ]
        return self._reducers

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


def _around(
    noise: DepthNoiseModel, settings: MapSettings, fallback: DepthNoiseModel | None
) -> list[DepthNoiseModel]:
    """Return the fallback for the distances below and above those that `noise` covers."""
    if fallback is None:
        return []
    wanted = _within_both_ranges(settings, fallback)
    # Readings are float32; the one at a bound belongs to `noise`.
    below = float(np.nextafter(np.float32(noise.range_min_m), np.float32(0.0)))
    above = float(np.nextafter(np.float32(noise.range_max_m), np.float32(np.inf)))
    parts = [(wanted.range_min_m, below), (above, wanted.range_max_m)]
    return [fallback.with_range(low, high) for low, high in parts if low < high]


def _together(parts: list[FloatArray]) -> FloatArray:
    """Return the sum of what reducers of separate distances hold; that of one is not copied."""
    return parts[0] if len(parts) == 1 else np.sum(parts, axis=0, dtype=parts[0].dtype)
