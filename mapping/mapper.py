"""The mapper: samples in, in the stream's order; an elevation map out.

Only sensor time enters. Live and offline differ in where the samples come from, not in here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from acquisition.messages.codec import Recordable
from acquisition.messages.frames import (
    BASE_FRAME,
    DEPTH_OPTICAL_FRAME,
    MOCAP_BODY_FRAME,
    StaticTransforms,
)
from drivers.samples import CameraIntrinsics, DepthFrame, PoseSample
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
from mapping.measurement import Float64Array, FrameReducer, View
from mapping.mounts import MountTree
from mapping.noise import DepthNoiseModel
from mapping.pose_track import PoseTrack
from mapping.settings import MapSettings

FloatArray = TypeVar("FloatArray", NDArray[np.float32], NDArray[np.float64])

# A depth frame waits this long, in stream time, for a pose that surrounds it.
_POSE_WAIT_NS = 2_000_000_000


@dataclass(slots=True)
class MapperCounts:
    """What became of the input.

    Attributes:
        frames: depth frames mapped.
        frames_without_pose: depth frames left out because no pose surrounds their time.
        poses, poses_out_of_order: poses taken; poses left out because they came out of order.
        readings: valid depth readings of the mapped frames, without those dropped (below).
        readings_outside: readings of them that fell outside the grid.
        readings_uncalibrated: readings of them at distances that the calibration does not cover;
            mapped with the fallback's noise.
        updates: cell updates. rejected: those that went to a second hypothesis. replaced: second
            hypotheses that took over. cleared: cells forgotten because rays passed through them.
        readings_own_body: readings dropped because they hit the rover itself.
        readings_overhanging: readings dropped because they hit what hangs high above the ground.
    """

    frames: int = 0
    frames_without_pose: int = 0
    poses: int = 0
    poses_out_of_order: int = 0
    readings: int = 0
    readings_outside: int = 0
    readings_uncalibrated: int = 0
    updates: int = 0
    rejected: int = 0
    replaced: int = 0
    cleared: int = 0
    readings_own_body: int = 0
    readings_overhanging: int = 0


class Mapper:
    """Fuses depth frames, seen from known poses, into a grid."""

    def __init__(
        self,
        settings: MapSettings,
        noise: DepthNoiseModel,
        grid: Grid | None = None,
        fallback: DepthNoiseModel | None = None,
    ) -> None:
        """Start with an empty map, or with a grid that knows cells already.

        Args:
            settings: how to map.
            noise: the depth camera's noise; holds within its own range.
            grid: knows cells already; None = an empty one.
            fallback: noise of readings that the settings want and `noise` does not cover;
                None = such readings are not mapped.

        Raises:
            MappingError: the ranges of settings and noise model have nothing in common.
        """
        self.settings = settings
        self.noise = _within_both_ranges(settings, noise)
        self.counts = MapperCounts()
        self._grid = grid or make_grid(settings)
        self._fusion = fusion_constants(settings)
        self._poses = PoseTrack(round(settings.pose_gap_max_s * 1e9))
        self._mounts = MountTree()
        self._waiting: list[DepthFrame] = []
        self._fallbacks = _around(self.noise, settings, fallback)
        self._reducers: list[FrameReducer] = []

    def add(self, sample: Recordable) -> None:
        """Take the next sample of the stream; others than depth, pose and mounts are ignored.

        Raises:
            MappingError: the mount is missing, a pose or mount is no pose, a depth image does not
                fit its camera, or the map outgrows memory.
        """
        if isinstance(sample, StaticTransforms):
            self._mounts.add(sample.transforms)
            return
        if isinstance(sample, PoseSample):
            self.counts.poses += self._poses.add(sample)
            self.counts.poses_out_of_order = self._poses.out_of_order
        elif isinstance(sample, DepthFrame):
            self._waiting.append(sample)
        self._map_ready_frames(sample.t_ns)

    def finish(self) -> None:
        """Map the frames that can be mapped and count the rest; the stream is over.

        Raises:
            MappingError: as `add`, or the grid cannot be saved.
        """
        waiting, self._waiting = self._waiting, []
        for frame in waiting:
            self._map_or_count(frame)
        self._grid.save()

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
        return read_out(self._grid, self.settings, attributes)

    def _map_ready_frames(self, now_ns: int) -> None:
        """Map waiting frames that a pose at or after their time, or patience, has released.

        Each frame waits for itself: one with a stamp in the future holds up no other.
        """
        newest_ns = self._poses.newest_ns
        waiting, self._waiting = self._waiting, []
        for frame in waiting:
            surrounded = newest_ns is not None and newest_ns >= frame.t_ns
            if surrounded or now_ns - frame.t_ns > _POSE_WAIT_NS:
                self._map_or_count(frame)
            else:
                self._waiting.append(frame)

    def _map_or_count(self, frame: DepthFrame) -> None:
        pose = self._poses.at(frame.t_ns)
        if pose is None:
            self.counts.frames_without_pose += 1
        else:
            self._map(frame, pose)

    def _map(self, frame: DepthFrame, pose: UncertainPose) -> None:
        """One depth frame's walk: readings, footprint, sums per cell, update."""
        mount = self._mounts.lookup(MOCAP_BODY_FRAME, DEPTH_OPTICAL_FRAME)
        view = View(pose, pose.transform @ mount)
        reducers = self._reducers_for(frame.camera)
        rover_x_m, rover_y_m, _ = pose.transform.translation_m
        farthest = max(reducers, key=lambda reducer: reducer.range_max_m)
        window = self._grid.prepare(farthest.footprint(view), rover_x_m, rover_y_m)
        sums = [self._reduce(reducer, frame, view, window) for reducer in reducers]
        constants = [
            reducer.frame_constants(view, window, self._grid.position(window))
            for reducer in reducers
        ]
        self._look_around(frame, view, _together(sums), constants[0])
        for part, constant in zip(sums, constants, strict=True):
            result = fuse(part, constant, self._fusion, self._grid.layers)
            self.counts.updates += result.cells
            self.counts.rejected += result.rejected
            self.counts.replaced += result.replaced
        self.counts.frames += 1

    def _reduce(
        self, reducer: FrameReducer, frame: DepthFrame, view: View, window: CellWindow
    ) -> Float64Array:
        """Return the sums over the window of the readings that a reducer takes."""
        readings = reducer.load(frame.depth_mm) - self._drop_own_body(reducer)
        constants = reducer.frame_constants(view, window, self._grid.position(window))
        readings -= self._drop_overhangs(reducer, view, constants)
        sums, inside = reducer.reduce(view, window)
        self.counts.readings += readings
        self.counts.readings_outside += readings - inside
        if reducer is not self._reducers[0]:
            self.counts.readings_uncalibrated += readings
        return sums[: window.cells_x * window.cells_y]

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
            self._reducers = [FrameReducer(camera, noise, self.settings) for noise in noises]
        return self._reducers

    def _why_nothing(self) -> str:
        counts = self.counts
        if counts.frames_without_pose == 0:
            return "the stream holds no depth frame; nothing can be mapped"
        if counts.poses == 0:
            return (
                f"the stream holds {counts.frames_without_pose} depth frames but no pose; record "
                "motion capture, or import with a trajectory"
            )
        return (
            f"none of {counts.frames_without_pose} depth frames lies between two of the "
            f"{counts.poses} poses within {self.settings.pose_gap_max_s} s; check that both use "
            "the same clock"
        )


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
