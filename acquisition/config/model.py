"""What rover.toml may say: names with units, ranges, defaults. `rover.toml` beside it explains."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from acquisition.messages.codec import MESSAGE_TYPES, DepthFormat
from acquisition.messages.frames import BASE_FRAME
from acquisition.messages.ros_fields import unit_quaternion
from drivers.source import SOURCES

# A recording played again is no device, but may stand for some.
REPLAY_KIND = "replay"
KINDS = (*SOURCES, REPLAY_KIND)

_Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
_NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
# 30 years: what is longer is a mistake, and more than timers take.
_Seconds = Annotated[float, Field(ge=0.0, le=1e9)]
_PositiveSeconds = Annotated[float, Field(gt=0.0, le=1e9)]
_Finite = Annotated[float, Field(allow_inf_nan=False)]
_Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$")]
_Path = Annotated[Path, Field(strict=False)]
_Count = Annotated[int, Field(ge=1)]
_Box = Annotated[tuple[_Finite, _Finite, _Finite, _Finite, _Finite, _Finite], Field(strict=False)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class RecordingSection(_Strict):
    """[recording]: where and how."""

    folder: _Path = Path()
    name: _Name = "rover"
    fallback_folders: Annotated[tuple[_Path, ...], Field(strict=False)] = ()
    depth_format: DepthFormat = "raw"
    flush_ms: Annotated[int, Field(ge=5, le=10_000)] = 50
    sync_s: Annotated[float, Field(ge=0.1, le=3600.0)] = 1.0
    split_mb: Annotated[int, Field(ge=0)] = 0
    split_s: _Seconds = 300.0
    ring_s: _Seconds = 0.0
    ring_memory_mb: _Count = 512
    disk_reserve_mb: Annotated[int, Field(ge=0)] = 500
    queue_mb: _Count = 64
    require_all: bool = False
    preflight_s: _PositiveSeconds = 10.0
    reconnect_s: _PositiveSeconds = 1.0
    realtime_priority: Annotated[int, Field(ge=0, le=99)] = 0


class DeviceClockSection(_Strict):
    """[devices.clock]: what is known about the device's own clock."""

    tick_rate_hz: _Positive | None = None
    wrap_ticks: Annotated[int, Field(ge=256)] | None = None
    window_s: _PositiveSeconds = 60.0
    max_drift_ppm: Annotated[float, Field(ge=0.0, lt=1e6)] = 500.0
    min_delay_ms: Annotated[float, Field(ge=0.0, le=1e6)] = 0.0

    @model_validator(mode="after")
    def _wraps_what_it_counts(self) -> Self:
        if self.wrap_ticks is not None and self.tick_rate_hz is None:
            raise ValueError("wrap_ticks is given without tick_rate_hz")
        return self


class DeviceEntry(BaseModel):
    """[[devices]]: a kind, and the settings of its driver, which knows them best."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True)

    kind: str
    name: _Name | None = None
    clock: DeviceClockSection = DeviceClockSection()

    @field_validator("kind")
    @classmethod
    def _is_known(cls, kind: str) -> str:
        if kind not in KINDS:
            raise ValueError(f"no device kind {kind!r}; expected one of {', '.join(sorted(KINDS))}")
        return kind

    def settings(self) -> dict[str, object]:
        """Return what the driver is constructed with."""
        name = {} if self.name is None else {"name": self.name}
        return name | (self.model_extra or {})


class Mount(_Strict):
    """[mounts.FRAME]: where a frame sits in its parent."""

    parent: str = BASE_FRAME
    position_m: Annotated[tuple[_Finite, _Finite, _Finite], Field(strict=False)]
    roll_pitch_yaw_deg: Annotated[tuple[_Finite, _Finite, _Finite] | None, Field(strict=False)] = (
        None
    )
    quaternion_wxyz: Annotated[
        tuple[_Finite, _Finite, _Finite, _Finite] | None, Field(strict=False)
    ] = None
    sigma_m: _NotNegative = 0.0
    sigma_deg: _NotNegative = 0.0

    @model_validator(mode="after")
    def _has_one_rotation(self) -> Self:
        if (self.roll_pitch_yaw_deg is None) == (self.quaternion_wxyz is None):
            raise ValueError("give either roll_pitch_yaw_deg or quaternion_wxyz")
        if self.quaternion_wxyz is not None:
            unit_quaternion(self.quaternion_wxyz)
        return self


class AlignmentSection(_Strict):
    """[map.alignment]: `mapping.alignment.settings.AlignmentSettings`."""

    form: Literal["6-dof", "z-roll-pitch"] = "6-dof"
    floor_m: _Positive = 0.001
    floor_rad: _Positive = math.radians(0.1)
    prior_sigma_m: _Positive = 0.01
    prior_sigma_rad: _Positive = math.radians(1.0)
    full_points: _Count = 700
    observable_m: _Positive = 0.006
    lever_m: _Positive = 1.5
    cells_per_independent: _Positive = 10.0
    cut_m: _Positive = 0.15
    farthest_m: _Positive = 0.25
    worst_scale: _Positive = 2.0
    most_misfits: _Count = 10
    robust_sigma: _Positive = 2.0
    fewest_pixels: _Count = 3
    fewest_points: _Count = 100
    iterations: _Count = 12


class GravitySection(_Strict):
    """[map.gravity]: `mapping.alignment.gravity.GravitySettings`."""

    window_s: _Positive = 5.0
    levelling_sigma_rad: _Positive = math.radians(2.0)
    levelling_time_s: _Positive = 0.3


class AlignedErrorsSection(_Strict):
    """[map.aligned_errors]: `mapping.motion.pose_errors.PoseErrorModel` of aligned poses."""

    pose_covariance: bool = False
    motion_covariance: bool = False
    frame_sigma_m: _NotNegative = 0.001
    frame_sigma_rad: _NotNegative = math.radians(0.03)
    drift_per_m: _NotNegative = 1.0
    gravity_sigma_rad: _NotNegative = math.radians(0.12)
    place_sigma_m: _NotNegative = 0.003
    heading_sigma_rad: _NotNegative = math.radians(0.05)


class MapSection(_Strict):
    """[map]: the settings of `mapping.settings.MapSettings`, without the mount's sigmas.

    The keys of [map.ego_motion] are those of `mapping.ego_motion.settings`, which checks them.
    """

    resolution_m: Annotated[float, Field(gt=0.0, le=0.5)] = 0.04
    grid: Literal["growing", "scrolling"] = "growing"
    window_m: _Positive = 6.0
    memory_limit_mb: _Positive = 4096.0
    gate_sigma: _Positive = 3.5
    confirmations: _Count = 3
    sigma_floor_m: _Positive = 0.0002
    sigma_ceiling_m: _Positive = 1.0
    common_correlation_time_s: _NotNegative = 0.3
    relief_share: _NotNegative = 0.02
    relief_frames: _NotNegative = 1.0
    range_min_m: _Positive = 0.4
    range_max_m: _Positive = 4.0
    confirmed_frames: _Count = 2
    confirmed_pixels: _Count = 4
    uncertain_sigma_m: _Positive = 0.015
    horizontal_share: _Positive = 0.25
    pose_gap_max_s: _Positive = 0.2
    seen_through_frames: Annotated[int, Field(ge=0, le=255)] = 5
    overhang_clearance_m: _NotNegative = 0.0
    body_boxes_m: Annotated[tuple[_Box, ...], Field(strict=False)] = ()
    pose_source: Literal["mocap", "mocap+alignment", "ego-motion", "ego-motion+alignment"] = "mocap"
    tilt_source: Literal["levelled", "level"] = "levelled"
    alignment: AlignmentSection = AlignmentSection()
    gravity: GravitySection = GravitySection()
    aligned_errors: AlignedErrorsSection = AlignedErrorsSection()
    ego_motion: dict[str, bool | float] = Field(default_factory=dict)


class CalibrationSection(_Strict):
    """[calibration]: files whose contents belong to the recording."""

    depth_noise: _Path | None = None
    others: Annotated[tuple[_Path, ...], Field(strict=False)] = ()


class RoverConfig(_Strict):
    """The whole file."""

    recording: RecordingSection = RecordingSection()
    devices: Annotated[tuple[DeviceEntry, ...], Field(strict=False)] = ()
    mounts: dict[str, Mount] = Field(default_factory=dict)
    rates_hz: dict[str, _Positive] = Field(default_factory=dict)
    map: MapSection = MapSection()
    calibration: CalibrationSection = CalibrationSection()

    @field_validator("mounts")
    @classmethod
    def _ends_somewhere(cls, mounts: dict[str, Mount]) -> dict[str, Mount]:
        for frame in mounts:
            passed, parent = {frame}, mounts[frame].parent
            while parent in mounts:
                if parent in passed:
                    raise ValueError(f"{frame} sits on itself, by way of {parent}")
                passed.add(parent)
                parent = mounts[parent].parent
            if parent in passed:
                raise ValueError(f"{frame} sits on itself")
        return mounts

    @field_validator("rates_hz")
    @classmethod
    def _are_topics(cls, rates_hz: dict[str, float]) -> dict[str, float]:
        topics = [row.topic for row in MESSAGE_TYPES]
        for topic in rates_hz:
            if topic not in topics:
                raise ValueError(f"no topic {topic!r}; expected one of {', '.join(topics)}")
        return rates_hz


# What each table of the file may hold, by its name without numbers and frames.
TABLES: Mapping[str, type[BaseModel]] = {
    "": RoverConfig,
    "recording": RecordingSection,
    "devices.clock": DeviceClockSection,
    "mounts": Mount,
    "map": MapSection,
    "map.alignment": AlignmentSection,
    "map.gravity": GravitySection,
    "map.aligned_errors": AlignedErrorsSection,
    "calibration": CalibrationSection,
}
