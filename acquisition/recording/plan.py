"""What the recorder is asked to do, and how it ended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from acquisition.clocks.clock_follower import ClockTuning
from acquisition.health.snapshot import HealthSnapshot
from acquisition.messages.codec import DepthFormat
from acquisition.messages.frames import StaticTransform
from acquisition.recording.preflight import PREFLIGHT_TIMEOUT_S, STOP_TIMEOUT_S
from acquisition.recording.source_worker import WorkerSettings
from drivers.samples import Sample

Outcome = Literal["stopped", "ended", "output_failed"]


@dataclass(frozen=True, slots=True)
class RecordingPlan:
    """How to record.

    Attributes:
        static_transforms: where the frames sit.
        settings: the resolved configuration, as JSON values; kept in the recording.
        rates_hz: expected rates, over what the sources say themselves.
        clocks: what is known about the sources' own clocks, by name of the source.
        require_all: refuse to start unless every source is there.
        depth_format: how depth frames are written.
        flush_interval_s: at most about so much is lost when the program is killed.
        preflight_timeout_s: how long a source may take to open.
        stop_timeout_s: how long the drivers may take to return at the end.
        worker: how each source is treated.
    """

    static_transforms: Sequence[StaticTransform] = ()
    settings: Mapping[str, object] = field(default_factory=dict)
    rates_hz: Mapping[type[Sample], float] = field(default_factory=dict)
    clocks: Mapping[str, ClockTuning] = field(default_factory=dict)
    require_all: bool = False
    depth_format: DepthFormat = "raw"
    flush_interval_s: float = 0.05
    preflight_timeout_s: float = PREFLIGHT_TIMEOUT_S
    stop_timeout_s: float = STOP_TIMEOUT_S
    worker: WorkerSettings = field(default_factory=WorkerSettings)


@dataclass(frozen=True, slots=True)
class RecordingResult:
    """How a recording ended.

    Attributes:
        outcome: "stopped" = as asked; "ended" = no source has more to give; "output_failed" =
            the disks are full or gone.
        message: one line for people.
        files: the recording's parts, in order.
        unwritten: samples that were read but not written, because the output failed.
        hanging: sources whose drivers did not return when they were asked to stop.
        health: the final figures.
    """

    outcome: Outcome
    message: str
    files: tuple[Path, ...]
    unwritten: int
    hanging: tuple[str, ...]
    health: HealthSnapshot
