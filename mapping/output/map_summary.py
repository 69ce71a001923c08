"""A map, and the run that made it, in a few lines."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from mapping.cells.elevation_map import CellState, ElevationMap
from mapping.judging.evaluation import CONFIRMED
from mapping.session import MapResult
from mapping.settings import MapSettings
from mapping.stored_settings import flat


@dataclass(frozen=True, slots=True)
class MapSummary:
    """What a map holds.

    Attributes:
        x_m, y_m: first and last cell centre.
        resolution_m: edge of a cell.
        cells: number of cells for each state but "unknown".
        height_m: smallest and largest height of confirmed cells; None without any.
        sigma_median_m: median sigma of confirmed cells; None without any.
        sha256: of the map's arrays.
        attributes: how the map was made.
    """

    x_m: tuple[float, float]
    y_m: tuple[float, float]
    resolution_m: float
    cells: dict[str, int]
    height_m: tuple[float, float] | None
    sigma_median_m: float | None
    sha256: str
    attributes: dict[str, str | int | float]

    def as_json(self) -> dict[str, object]:
        """Return the summary as JSON values, under the names of its attributes."""
        return asdict(self)

    def describe(self) -> list[str]:
        """Return the summary as lines for people, without settings that have their defaults."""
        usual = dict(flat("setting", asdict(MapSettings())))
        told = {name: value for name, value in self.attributes.items() if usual.get(name) != value}
        return [
            *self.headline(),
            *(f"  {key} = {value}" for key, value in told.items()),
            f"  {len(self.attributes) - len(told)} settings have their defaults; --json shows them",
        ]

    def headline(self) -> list[str]:
        """Return size, heights and checksum, without how the map was made."""
        cells = ", ".join(f"{count} {name}" for name, count in self.cells.items())
        size_x, size_y = (high - low + self.resolution_m for low, high in (self.x_m, self.y_m))
        heights = "  no height is confirmed"
        if self.height_m is not None and self.sigma_median_m is not None:
            heights = (
                f"  heights {self.height_m[0]:.3f} to {self.height_m[1]:.3f} m, "
                f"median sigma {1000 * self.sigma_median_m:.1f} mm"
            )
        return [
            f"  {size_x:.2f} m x {size_y:.2f} m at {self.resolution_m} m; cells: {cells}",
            heights,
            f"  sha256 {self.sha256}",
        ]


@dataclass(frozen=True, slots=True)
class RunSummary:
    """A map and what became of the stream that it was made from.

    Attributes:
        output: the map's file.
        map: what it holds.
        counts: the mapper's counts; see `mapping.mapper.MapperCounts`.
        warnings: everything that was not mapped, one line each.
    """

    output: str
    map: MapSummary
    counts: dict[str, int]
    warnings: tuple[str, ...]

    def as_json(self) -> dict[str, object]:
        """Return the summary as JSON values, under the names of its attributes."""
        return asdict(self)

    def describe(self) -> list[str]:
        """Return the summary as lines for people."""
        c = self.counts
        became = (
            f"{self.output}: {c['frames']} depth frames, {c['readings'] / 1e6:.2f} M readings, "
            f"{c['updates']} cell updates, {c['rejected']} rejected, {c['replaced']} replaced"
        )
        return [became, *self.map.headline()]


def summarise(map_: ElevationMap) -> MapSummary:
    """Return what a map holds."""
    confirmed = np.isin(map_.state, CONFIRMED)
    heights = map_.elevation_m[confirmed]
    extremes = (float(heights.min()), float(heights.max())) if heights.size else None
    sigma = float(np.median(map_.sigma_m[confirmed])) if heights.size else None
    return MapSummary(
        x_m=(float(map_.x_m[0]), float(map_.x_m[-1])),
        y_m=(float(map_.y_m[0]), float(map_.y_m[-1])),
        resolution_m=map_.resolution_m,
        cells={
            state.name.lower(): int(np.count_nonzero(map_.state == state))
            for state in CellState
            if state != CellState.UNKNOWN
        },
        height_m=extremes,
        sigma_median_m=sigma,
        sha256=map_.sha256(),
        attributes=dict(map_.attributes),
    )


def summarise_run(result: MapResult, output: str) -> RunSummary:
    """Return what a run made, and everything that it left out."""
    return RunSummary(
        output=output,
        map=summarise(result.map),
        counts=asdict(result.counts),
        warnings=tuple(_warnings(result)),
    )


def _warnings(result: MapResult) -> list[str]:
    report, counts = result.report, result.counts
    lines = report.losses("; use a larger --reorder-window-s")
    lines += [result.noise_warning] if result.noise_warning else []
    lines += result.inertial.warnings if result.inertial is not None else ()
    if report.unprotected_messages:
        lines.append(f"{report.unprotected_messages} messages have no checksum")
    lines += _about_cameras(result)
    if not np.isin(result.map.state, CONFIRMED).any():
        wanted = result.settings
        lines.append(
            f"no cell is confirmed, which takes {wanted.confirmed_frames} frames and "
            f"{wanted.confirmed_pixels} readings of it, after {counts.frames} frames: no height of "
            "this map is to be relied on"
        )
    if counts.frames_known:
        lines.append(
            f"{counts.frames_known} depth frames were in the world already and are not counted "
            f"again; {counts.frames} are new"
        )
    if counts.frames_without_pose:
        lines.append(_without_pose(counts.frames_without_pose, result.settings))
    if 2 * counts.readings_outside > counts.readings:
        lines.append(
            f"{counts.readings_outside} of {counts.readings} readings fell outside the window of "
            f"{result.settings.window_m:g} m around the rover and were not mapped"
        )
    if counts.misfits:
        lines.append(
            f"{counts.misfits} depth frames fit the map nowhere near their pose; the first of each "
            "row of them were not mapped"
        )
    if counts.slid:
        lines.append(
            f"the map has slid against gravity at {counts.slid} depth frames; its variance holds "
            "the tilt"
        )
    if counts.readings_uncalibrated:
        noise = result.noise
        lines.append(
            f"{counts.readings_uncalibrated} of {counts.readings} readings lie outside "
            f"{noise.range_min_m:.2f} to {noise.range_max_m:.2f} m, for which {noise.name} was "
            "measured; the default noise model was used for them"
        )
    if counts.poses_out_of_order:
        lines.append(f"{counts.poses_out_of_order} poses came out of order and were not used")
    return lines


def _about_cameras(result: MapResult) -> list[str]:
    """Say what speaks against all depth frames being of one camera in one place."""
    lines = []
    each = "map the recording of each camera by itself, into one --world with --continue"
    if len(result.depth_devices) > 1:
        names = ", ".join(f"{d.model} {d.serial}".strip() for d in result.depth_devices)
        lines.append(
            f"the recording has {len(result.depth_devices)} depth cameras ({names}), mapped with "
            f"one mount and one noise model; {each}"
        )
    if result.counts.camera_changes:
        lines.append(
            f"the depth camera's intrinsics changed {result.counts.camera_changes} times; every "
            f"frame is mapped with its own, all with one mount; if it is not one camera, {each}"
        )
    if result.counts.mounts_replaced:
        lines.append(
            f"{result.counts.mounts_replaced} mounts of /tf_static were given again with other "
            "numbers; the later ones count from where they stand in the recording"
        )
    others = {name: n for name, n in result.report.skipped.items() if "depth" in name}
    lines += [
        f"{number} messages of {name} are not mapped; depth is read from /depth/image alone"
        for name, number in others.items()
    ]
    return lines


def _without_pose(frames: int, settings: MapSettings) -> str:
    """Say that frames have no pose, in the terms of the source that they should have one from."""
    if settings.pose_source.startswith("mocap"):
        return (
            f"{frames} depth frames have no pose within {settings.pose_gap_max_s} s around them "
            "and were not mapped"
        )
    return (
        f"{frames} depth frames lie before the first sample of the motion sensors or behind the "
        "last and were not mapped"
    )
