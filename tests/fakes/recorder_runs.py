"""Short runs of the recorder on scripted sources and a fixed clock; not faked: threads, disk."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count
from pathlib import Path
from threading import Event
from typing import Any

from acquisition.clocks.clock_sample import ClockSample
from acquisition.recording.disk_output import DiskOutput
from acquisition.recording.folder_store import DiskSettings
from acquisition.recording.plan import RecordingPlan, RecordingResult
from acquisition.recording.recorder import Recorder
from acquisition.recording.source_worker import WorkerSettings
from acquisition.stream.byte_source import FinishedFile
from acquisition.stream.reader import StreamMessage, StreamReader
from drivers.samples import PoseSample, Sample
from tests.fakes.recordings import MOUNT, START_NS, acceleration, pose
from tests.fakes.scripted_source import ScriptedSource, Step

MS = 1_000_000
QUICK = RecordingPlan(
    static_transforms=[MOUNT],
    settings={"rover": "test"},
    flush_interval_s=0.002,
    worker=WorkerSettings(read_timeout_s=0.01, reconnect_s=0.001),
)


class FixedClock:
    """Does not move; log time = monotonic time + START_NS."""

    def now_ns(self) -> int:
        return 0

    def log_time_ns(self, mono_ns: int) -> int:
        return mono_ns + START_NS

    def samples(self, sequence: int) -> list[ClockSample]:
        return [ClockSample(0, "host", 0, 0, START_NS, "boot", START_NS, sequence=sequence)]


class SecondsClock(FixedClock):
    """A second passes whenever somebody looks."""

    def __init__(self) -> None:
        self._ticks = count()

    def now_ns(self) -> int:
        return next(self._ticks) * 10**9


def accelerations(first: int, last: int, offset_ns: int = 0) -> list[list[Sample]]:
    """Return one read for each sample, 1 ms apart."""
    return [[acceleration(i, offset_ns + i * MS)] for i in range(first, last)]


def poses(count: int) -> list[list[Sample]]:
    return [[pose(i, i * MS)] for i in range(count)]


def tracker(script: Sequence[Step], **options: Any) -> ScriptedSource:
    return ScriptedSource("tracker", script, produces=(PoseSample,), **options)


def output(path: Path) -> DiskOutput:
    return DiskOutput(path, DiskSettings(reserve_bytes=0))


def record(
    path: Path,
    sources: Sequence[ScriptedSource],
    plan: RecordingPlan = QUICK,
    stop: Event | None = None,
) -> RecordingResult:
    recorder = Recorder(sources, output(path), plan, FixedClock())
    return recorder.run(stop or Event())


def read(path: Path) -> tuple[list[StreamMessage], dict[str, dict[str, str]]]:
    with FinishedFile(path) as file:
        reader = StreamReader(file)
        messages = list(reader)
        assert reader.report.complete
        assert not reader.report.damaged
        return messages, reader.metadata


def of_type(messages: Sequence[StreamMessage], kind: type) -> list[Any]:
    return [message.sample for message in messages if isinstance(message.sample, kind)]
