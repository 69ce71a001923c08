"""Frames of a cell through the real recorder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from threading import Event
from typing import Protocol

from acquisition.config.rover_file import LoadedConfig, load
from acquisition.config.use import plan_of, sources_of
from acquisition.health.snapshot import HealthSnapshot
from acquisition.recording.disk_output import DiskOutput
from acquisition.recording.plan import RecordingPlan
from acquisition.recording.recorder import Recorder
from calibration_rigs.errors import RigError
from drivers.source import Source

_DEPTH_KINDS = ("openni", "replay", "png", "tum")
_DEPTH_TOPIC = "/depth/image"


class Capture(Protocol):
    """Records a number of frames into a file."""

    def record(self, path: Path, frames: int) -> None:
        """Record at least `frames` frames, or as many as the camera has.

        Raises:
            TerravibeError: the camera is missing or failed, or the disk refused.
        """


class SourceCapture:
    """Records sources that are made anew for each recording."""

    def __init__(
        self, sources: Callable[[], Sequence[Source]], plan: RecordingPlan | None = None
    ) -> None:
        self._sources = sources
        self._plan = plan or RecordingPlan()

    def record(self, path: Path, frames: int) -> None:
        """See `Capture`."""
        stop = Event()

        def beat(snapshot: HealthSnapshot) -> None:
            """Stop when there are enough frames."""
            if frames_of(snapshot) >= frames:
                stop.set()

        plan = replace(self._plan, require_all=True)
        result = Recorder(self._sources(), DiskOutput(path), plan).run(stop, beat)
        if result.outcome == "output_failed":
            raise RigError(f"{path} is not whole: {result.message}")
        if lost := [s.error for s in result.health.sources if s.state == "lost"]:
            raise RigError(f"the camera was lost while recording {path.name}: {lost[0]}")


class RoverCapture:
    """Records the depth cameras of a rover.toml, without its other devices."""

    def __init__(self, config: Path) -> None:
        """Read the file, before anybody carries a plate; touch no device.

        Raises:
            TerravibeError: the file is unusable, or has no depth camera.
        """
        self._config = config
        sources_of(self._cameras())

    def record(self, path: Path, frames: int) -> None:
        """See `Capture`; what was mended in the file meanwhile counts."""
        cameras = self._cameras()
        plan = plan_of(cameras, sources_of(cameras))
        SourceCapture(lambda: sources_of(cameras), plan).record(path, frames)

    def _cameras(self) -> LoadedConfig:
        """Return the configuration with its depth cameras alone."""
        loaded = load(self._config)
        devices = tuple(d for d in loaded.config.devices if d.kind in _DEPTH_KINDS)
        if not devices:
            raise RigError(
                f"{self._config} has no depth camera; expected a [[devices]] of kind "
                f"{' or '.join(_DEPTH_KINDS)}"
            )
        return replace(loaded, config=loaded.config.model_copy(update={"devices": devices}))


def frames_of(snapshot: HealthSnapshot) -> int:
    """Return how many depth frames a recording holds so far."""
    return sum(
        stream.statistics.samples
        for source in snapshot.sources
        for stream in source.streams
        if stream.topic == _DEPTH_TOPIC
    )
