"""What a map is made with: every number with its unit in its name, and a default that works."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, get_args

from mapping.alignment.gravity import GravitySettings
from mapping.alignment.settings import AlignmentSettings
from mapping.ego_motion.settings import EgoMotionSettings
from mapping.errors import MappingError
from mapping.motion.pose_errors import ALIGNED, PoseErrorModel
from mapping.poses.settings import PoseSourceName, TiltSource

GridKind = Literal["growing", "scrolling"]

# Far beyond every sensible value; squares and nanoseconds of it can still be counted.
_LARGEST = 1e9
# As wide as a small rover: coarser cells tell it nothing, and were meant in centimetres.
_COARSEST_CELL_M = 0.5
_POSITIVE = (
    "resolution_m",
    "window_m",
    "memory_limit_mb",
    "gate_sigma",
    "confirmations",
    "sigma_floor_m",
    "sigma_ceiling_m",
    "range_min_m",
    "range_max_m",
    "confirmed_frames",
    "confirmed_pixels",
    "uncertain_sigma_m",
    "horizontal_share",
    "pose_gap_max_s",
)
_NOT_NEGATIVE = (
    "common_correlation_time_s",
    "relief_share",
    "relief_frames",
    "mount_sigma_m",
    "mount_sigma_rad",
    "seen_through_frames",
    "overhang_clearance_m",
)
_ORDERED = (
    ("range_min_m", "range_max_m"),
    ("sigma_floor_m", "sigma_ceiling_m"),
    ("resolution_m", "window_m"),
)
_CHOICES = {"grid": GridKind, "pose_source": PoseSourceName, "tilt_source": TiltSource}


@dataclass(frozen=True, slots=True)
class MapSettings:
    """Settings of a mapping run; stored in the map file.

    Attributes:
        resolution_m: edge of a square cell; half a metre at most.
        grid: "growing" keeps everything that was seen; "scrolling" keeps a window around the
            rover and forgets what leaves it.
        window_m: edge of that window.
        memory_limit_mb: a map whose cells would need more is refused; while it grows and while it
            is read out, up to three times as much is in use.
        gate_sigma: a measurement further than this from the cell goes to the second hypothesis.
        confirmations: consistent rejects after which the second hypothesis replaces the cell.
        sigma_floor_m, sigma_ceiling_m: a cell's frame-to-frame sigma is held between these.
        common_correlation_time_s: time over which the errors of successive poses are alike.
        relief_share: share of the spread inside a cell, and of the roughness around it, that no
            number of frames averages away.
        relief_frames: the roughness around a cell counts this many times over the number of
            frames in addition.
        mount_sigma_m, mount_sigma_rad: uncertainty of the sensor's mount on the tracked body.
        range_min_m, range_max_m: nearer and farther readings are not mapped.
        confirmed_frames, confirmed_pixels: a cell with fewer is "unconfirmed".
        uncertain_sigma_m: a cell known no better than this is "uncertain"; the default keeps the
            3-sigma bounds of "measured" cells within +-4.5 cm, below a small rover's clearance.
        horizontal_share: variance of a cell's place along x and y from the start, in squares of
            its edge: 1/4 is paper eq. 17, (d/2)^2; 1/12 is a reading anywhere in the cell.
        pose_gap_max_s: poses are not interpolated across a longer gap; such frames are left out.
        seen_through_frames: frames whose rays pass through a cell after which it is forgotten;
            0 = never, and hidden cells are not marked either; see `mapping.change`.
        overhang_clearance_m: readings higher than this above their cell's lowest surface are
            dropped; 0 = never, see `mapping.change.overhang`.
        body_boxes_m: boxes around the rover's own parts, in the rover frame, each as (x_min,
            y_min, z_min, x_max, y_max, z_max); readings inside are dropped.
        pose_source: the stream's own poses ("mocap"), or those of "ego-motion"; either of them
            may be corrected by what the map says ("+alignment").
        tilt_source: what ego-motion knows roll and pitch from: "levelled" accelerations, or the
            ground, which is taken to be "level" to within ego_motion.tilt_lost_rad.
        alignment, gravity: how frames are aligned with the map, and when it has slid.
        aligned_errors: what aligned poses are worth.
        ego_motion: what ego-motion assumes of sensors and vehicle.
    """

    resolution_m: float = 0.04
    grid: GridKind = "growing"
    window_m: float = 6.0
    memory_limit_mb: float = 4096.0
    gate_sigma: float = 3.5
    confirmations: int = 3
    sigma_floor_m: float = 0.0002
    sigma_ceiling_m: float = 1.0
    common_correlation_time_s: float = 0.3
    relief_share: float = 0.02
    relief_frames: float = 1.0
    mount_sigma_m: float = 0.0
    mount_sigma_rad: float = 0.0
    range_min_m: float = 0.4
    range_max_m: float = 4.0
    confirmed_frames: int = 2
    confirmed_pixels: int = 4
    uncertain_sigma_m: float = 0.015
    horizontal_share: float = 0.25
    pose_gap_max_s: float = 0.2
    seen_through_frames: int = 5
    overhang_clearance_m: float = 0.0
    body_boxes_m: tuple[tuple[float, ...], ...] = ()
    pose_source: PoseSourceName = "mocap"
    tilt_source: TiltSource = "levelled"
    alignment: AlignmentSettings = field(default_factory=AlignmentSettings)
    gravity: GravitySettings = field(default_factory=GravitySettings)
    aligned_errors: PoseErrorModel = ALIGNED
    ego_motion: EgoMotionSettings = field(default_factory=EgoMotionSettings)

    def __post_init__(self) -> None:
        """Refuse values that no map can be made with."""
        for name in _POSITIVE:
            if not 0.0 < getattr(self, name) <= _LARGEST:
                raise MappingError(
                    f"{name} is {getattr(self, name)}; expected a number above 0, to {_LARGEST:g}"
                )
        for name in _NOT_NEGATIVE:
            if not 0.0 <= getattr(self, name) <= _LARGEST:
                raise MappingError(
                    f"{name} is {getattr(self, name)}; expected 0 or more, to {_LARGEST:g}"
                )
        if self.resolution_m > _COARSEST_CELL_M:
            raise MappingError(
                f"resolution_m, the edge of a cell, is {self.resolution_m:g} m; expected at most "
                f"{_COARSEST_CELL_M} m: give metres, 4 cm are 0.04"
            )
        for low, high in _ORDERED:
            if getattr(self, low) >= getattr(self, high):
                raise MappingError(
                    f"{low} is {getattr(self, low)} and {high} is {getattr(self, high)}; "
                    f"expected {low} below {high}"
                )
        for name, choices in _CHOICES.items():
            if getattr(self, name) not in get_args(choices):
                raise MappingError(
                    f"{name} is {getattr(self, name)!r}; expected {' or '.join(get_args(choices))}"
                )
        for name in ("confirmations", "seen_through_frames"):
            if getattr(self, name) > 255:
                raise MappingError(f"{name} is {getattr(self, name)}; expected at most 255")
        object.__setattr__(self, "body_boxes_m", _boxes(self.body_boxes_m))


def _boxes(boxes_m: Sequence[Sequence[float]]) -> tuple[tuple[float, ...], ...]:
    """Return boxes as tuples.

    Raises:
        MappingError: one is no box.
    """
    for box in boxes_m:
        if not _is_box(box):
            raise MappingError(
                f"body_boxes_m has {box!r}; expected x_min, y_min, z_min, x_max, y_max, z_max in "
                "metres, each minimum below its maximum"
            )
    return tuple(tuple(map(float, box)) for box in boxes_m)


def _is_box(box: object) -> bool:
    if not isinstance(box, list | tuple) or len(box) != 6:
        return False
    if not all(isinstance(value, int | float) and math.isfinite(value) for value in box):
        return False
    return all(low < high for low, high in zip(box[:3], box[3:], strict=True))
