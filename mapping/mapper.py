"""The mapper: samples in, in the stream's order; an elevation map out.

Only sensor time enters. Live and offline differ in where the samples come from, not in here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from acquisition.messages.codec import Recordable
from acquisition.messages.frames import DEPTH_OPTICAL_FRAME, StaticTransforms
from drivers.samples import CameraIntrinsics, DepthFrame
from mapping.alignment.localiser import Localiser
from mapping.cells.elevation_map import ElevationMap, read_out
from mapping.cells.grid import make_grid
from mapping.cells.update_constants import fusion_constants
from mapping.cells.update_kernels import fuse
from mapping.errors import MappingError
from mapping.geometry import UncertainPose
from mapping.measurement import FrameReducer, View
from mapping.mounts import MountTree
from mapping.noise import DepthNoiseModel
from mapping.poses.choice import is_aligned, pose_source_for
from mapping.poses.source import PoseSource
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
        pose_events: things that estimated poses suffered from.
        aligned, unaligned, disbelieved, slid: frames whose pose the map corrected; to which it
            had nothing to say; whose correction the pose source found too unlikely; at which the
            map's idea of gravity was found wrong.
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
    pose_events: int = 0
    aligned: int = 0
    unaligned: int = 0
    disbelieved: int = 0
    slid: int = 0


class Mapper:
    """Fuses depth frames, seen from known or estimated poses, into a grid."""

    def __init__(
        self,
        settings: MapSettings,
        noise: DepthNoiseModel,
        on_pose: Callable[[UncertainPose], None] = lambda _: None,
    ) -> None:
        """Start with an empty map; `on_pose` is told the pose of every frame that is mapped.

        Raises:
            MappingError: the ranges of settings and noise model have nothing in common.
        """
        self.settings = settings
        self.noise = _within_both_ranges(settings, noise)
        self.counts = MapperCounts()
        self._grid = make_grid(settings)
        self._fusion = fusion_constants(settings)
        self._on_pose = on_pose
        self._poses = pose_source_for(settings)
        self._mounts = MountTree()
        self._localiser = _localiser(settings, self._poses, self._mounts)
        self._waiting: list[DepthFrame] = []
        self._reducer: FrameReducer | None = None

    def add(self, sample: Recordable) -> None:
        """Take the next sample of the stream; others than depth, pose and mounts are ignored.

        Raises:
            MappingError: the mount is missing, a pose or mount is no pose, a depth image does not
                fit its camera, or the map outgrows memory.
        """
        if isinstance(sample, StaticTransforms):
            self._mounts.add(sample.transforms)
        self._poses.add(sample)
        if self._localiser is not None:
            self._localiser.add(sample)
        if isinstance(sample, DepthFrame):
            self._waiting.append(sample)
        self._map_ready_frames(sample.t_ns)
        self._count_poses()

    def finish(self) -> None:
        """Map the frames that can be mapped and count the rest; the stream is over."""
        self._poses.finish()
        waiting, self._waiting = self._waiting, []
        for frame in waiting:
            self._map_or_count(frame)
        self._count_poses()

    def _count_poses(self) -> None:
        """Copy the counts of those that count for themselves."""
        poses = self._poses.counts
        self.counts.poses, self.counts.poses_out_of_order = poses.poses, poses.out_of_order
        self.counts.pose_events = poses.events
        if self._localiser is not None:
            found = self._localiser.counts
            self.counts.aligned, self.counts.unaligned = found.aligned, found.unaligned
            self.counts.disbelieved, self.counts.slid = found.rejected, found.slid

    def elevation_map(self, attributes: dict[str, str | int | float] | None = None) -> ElevationMap:
        """Return the map as it is now.

        Raises:
            MappingError: nothing has been mapped; the message says why.
        """
        if self.counts.frames == 0:
            raise MappingError(self._why_nothing())
        return read_out(self._grid, self.settings, attributes or {})

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
        """One depth frame's walk: readings, pose, footprint, sums per cell, update."""
        reducer = self._reducer_for(frame.camera)
        mount = self._mounts.lookup(self._poses.body_frame, DEPTH_OPTICAL_FRAME)
        readings = reducer.load(frame.depth_mm)
        pose: UncertainPose | None = prior
        if self._localiser is not None:
            pose = self._localiser.refine(reducer, prior, mount, self._grid)
        if pose is None:
            return
        view = View(pose, pose.transform @ mount)
        rover_x_m, rover_y_m, _ = pose.transform.translation_m
        window = self._grid.prepare(reducer.footprint(view), rover_x_m, rover_y_m)
        sums, inside = reducer.reduce(view, window)
        constants = reducer.frame_constants(view, window, self._grid.position(window))
        result = fuse(sums, constants, self._fusion, self._grid.layers)
        self.counts.frames += 1
        self.counts.readings += readings
        self.counts.readings_outside += readings - inside
        self.counts.updates += result.cells
        self.counts.rejected += result.rejected
        self.counts.replaced += result.replaced
        self._on_pose(pose)

    def _reducer_for(self, camera: CameraIntrinsics) -> FrameReducer:
        if self._reducer is None or self._reducer.camera != camera:
            self._reducer = FrameReducer(camera, self.noise, self.settings)
        return self._reducer

    def _why_nothing(self) -> str:
        if self.counts.frames_without_pose == 0:
            return "the stream holds no depth frame; nothing can be mapped"
        return self._poses.why_nothing(self.counts.frames_without_pose)


def _localiser(settings: MapSettings, poses: PoseSource, mounts: MountTree) -> Localiser | None:
    """Return what aligns frames, where the settings want it."""
    if not is_aligned(settings):
        return None
    return Localiser(poses, mounts, settings.alignment, settings.gravity, settings.resolution_m)


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
