"""What goes wrong in the field besides the data: late and swapped devices, stops, dead displays."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from threading import Event

import pytest

from acquisition.errors import StreamError
from acquisition.health.snapshot import HealthSnapshot
from acquisition.messages.frames import StaticTransform
from acquisition.recording.preflight import stop_all
from acquisition.recording.recorder import Recorder
from acquisition.recording.source_worker import SourceWorker, WorkerSettings
from drivers.errors import DriverError
from drivers.samples import AccelerationSample, PoseSample, Sample, frozen_array
from drivers.source import SourceInfo
from tests.acquisition.test_stream_writer import files_may_grow_to
from tests.fakes.recorder_runs import (
    MS,
    QUICK,
    FixedClock,
    SecondsClock,
    accelerations,
    of_type,
    output,
    poses,
    read,
    record,
    tracker,
)
from tests.fakes.recordings import acceleration
from tests.fakes.scripted_source import ScriptedSource


class Flag:
    """A stop that can only be looked at: who waits for an `Event` may hang in a signal handler."""

    def __init__(self) -> None:
        self.raised = False

    def set(self) -> None:
        self.raised = True

    def is_set(self) -> bool:
        return self.raised


class Swapped(ScriptedSource):
    """After it was lost, another device answers."""

    def open(self) -> SourceInfo:
        info = super().open()
        return replace(info, serial="other", produces=(PoseSample,)) if self.opened > 1 else info


class Backlog(ScriptedSource):
    """Has an old sample in its buffer, which a read that does not wait finds."""

    def __init__(self, script: list[list[Sample]]) -> None:
        super().__init__("imu", script)
        self.emptied = Event()

    def read(self, timeout_s: float) -> Sequence[Sample]:
        if timeout_s > 0.0 and self.emptied.is_set():
            return super().read(timeout_s)
        old = () if self.emptied.is_set() else (acceleration(99, 0),)
        self.emptied.set()
        return old


def test_a_stop_is_only_looked_at(tmp_path: Path) -> None:
    stop = Flag()
    imu = ScriptedSource("imu", [*accelerations(0, 5), stop.set], goes_on=True)
    result = Recorder([imu], output(tmp_path / "r.mcap"), QUICK, FixedClock()).run(stop)
    assert result.outcome == "stopped"


def test_a_stop_while_devices_are_looked_for_leaves_nothing(tmp_path: Path) -> None:
    stop, released = Event(), Event()

    class Hangs(ScriptedSource):
        def open(self) -> SourceInfo:
            stop.set()
            released.wait(10.0)
            return super().open()

    plan = replace(QUICK, preflight_timeout_s=60.0, stop_timeout_s=0.0)
    recorder = Recorder([Hangs("imu", [])], output(tmp_path / "r.mcap"), plan)
    result = recorder.run(stop)
    released.set()
    assert recorder._workers[0].join(5.0)
    assert (result.outcome, result.files, result.hanging) == ("stopped", (), ("imu",))
    assert not list(tmp_path.iterdir())


def test_what_came_before_the_recording_is_not_stamped_as_its_first() -> None:
    imu = Backlog([[acceleration(0, 5)]])
    worker = SourceWorker(imu, FixedClock(), WorkerSettings(read_timeout_s=0.01))
    worker.start()
    assert imu.emptied.wait(2.0)
    worker.go()
    assert imu.exhausted.wait(2.0)
    assert stop_all([worker], 2.0) == []
    assert [s.sequence for batch in worker.queue.take() for s in batch.samples] == [0]


def test_a_late_source_whose_times_are_of_another_kind_is_refused(tmp_path: Path) -> None:
    stop = Event()
    late = tracker(
        poses(5), opens=[DriverError("tracker: off")] * 3, time_base="recorded", goes_on=True
    )
    imu = ScriptedSource("imu", accelerations(0, 5), goes_on=True)
    recorder = Recorder([imu, late], output(tmp_path / "r.mcap"), QUICK, SecondsClock())

    def beat(snapshot: HealthSnapshot) -> None:
        if snapshot.sources[1].state in ("refused", "running"):
            stop.set()

    result = recorder.run(stop, beat)
    assert "record them separately" in result.health.sources[1].error
    messages, _ = read(tmp_path / "r.mcap")
    assert not of_type(messages, PoseSample)


def test_another_device_at_the_same_place_is_recorded_and_named(tmp_path: Path) -> None:
    swapped = Swapped("imu", [*accelerations(0, 5), DriverError("imu: unplugged"), *poses(5)])
    record(tmp_path / "r.mcap", [swapped])
    messages, metadata = read(tmp_path / "r.mcap")
    assert len(of_type(messages, AccelerationSample)) == len(of_type(messages, PoseSample)) == 5
    assert json.loads(metadata["terravibe"]["source.imu"])["serial"] == "other"


def test_a_played_recording_that_fails_is_not_played_again(tmp_path: Path) -> None:
    damaged = ScriptedSource(
        "again",
        [*accelerations(0, 5), DriverError("again: damaged"), *accelerations(0, 5)],
        time_base="recorded",
    )
    result = record(tmp_path / "r.mcap", [damaged])
    messages, _ = read(tmp_path / "r.mcap")
    assert len(of_type(messages, AccelerationSample)) == 5
    assert result.outcome == "ended"
    assert result.message.endswith("; again: damaged")
    assert result.health.sources[0].state == "lost"


def test_a_close_that_fails_at_the_end_is_no_loss(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stop = Event()
    imu = ScriptedSource("imu", [*accelerations(0, 5), stop.set], goes_on=True)

    def fail() -> None:
        raise DriverError("imu: gone")

    monkeypatch.setattr(imu, "close", fail)
    (health,) = record(tmp_path / "r.mcap", [imu], stop=stop).health.sources
    assert (health.losses, health.state, health.error) == (0, "closed", "imu: gone")


def test_a_display_that_is_gone_ends_no_recording(tmp_path: Path) -> None:
    stop = Event()
    imu = ScriptedSource("imu", accelerations(0, 5), goes_on=True)
    recorder = Recorder([imu], output(tmp_path / "r.mcap"), QUICK, SecondsClock())
    calls: list[object] = []

    def beat(snapshot: HealthSnapshot) -> None:
        calls.append(snapshot)
        if len(calls) == 2:
            stop.set()
        raise BrokenPipeError(32, "Broken pipe")

    assert recorder.run(stop, beat).outcome == "stopped"


def test_mounts_that_cannot_be_written_are_refused_before_anything_is_lost(tmp_path: Path) -> None:
    nowhere = frozen_array((float("nan"), 0.0, 0.0), (3,))
    mount = StaticTransform("rover", "imu", nowhere, frozen_array((1.0, 0.0, 0.0, 0.0), (4,)))
    imu = ScriptedSource("imu", accelerations(0, 5))
    with pytest.raises(StreamError, match=r"/tf_static .* position is not finite"):
        record(tmp_path / "r.mcap", [imu], replace(QUICK, static_transforms=[mount]))
    assert not list(tmp_path.iterdir())


def test_a_recording_whose_end_fails_still_names_its_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stop, path = Event(), tmp_path / "r.mcap"
    imu = ScriptedSource("imu", [[acceleration(0, MS)], stop.set], goes_on=True)
    disk = output(path)
    close = disk.close

    def close_full_disk() -> tuple[Path, ...]:
        with files_may_grow_to(disk.state().bytes_written + 10):
            return close()

    monkeypatch.setattr(disk, "close", close_full_disk)
    result = Recorder([imu], disk, QUICK, FixedClock()).run(stop)
    assert (result.outcome, result.files) == ("output_failed", (path,))
