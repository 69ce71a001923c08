"""The recorder's sources: each at its own pace and peril, none to another's loss."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from threading import Event

import pytest

from acquisition.errors import RecorderError
from acquisition.health.diagnostics import Diagnostics
from acquisition.health.snapshot import HealthSnapshot
from acquisition.inspection import check, inspect
from acquisition.recording.plan import RecordingPlan
from acquisition.recording.preflight import preflight, stop_all, try_all
from acquisition.recording.recorder import Recorder
from acquisition.recording.source_worker import SourceWorker, WorkerSettings
from acquisition.stream.split_writer import STATISTICS_NAME
from drivers.errors import DriverError
from drivers.faults import Faults
from drivers.samples import AccelerationSample, PoseSample, Sample
from drivers.source import SourceInfo
from tests.fakes.device_samples import MAKERS
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
from tests.fakes.scripted_source import ScriptedSource, Step


def test_a_replugged_source_goes_on_and_the_others_lose_nothing(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    unplugged = DriverError("imu: unplugged")
    script: list[Step] = [
        *accelerations(0, 30),
        unplugged,
        *accelerations(0, 30, offset_ns=500 * MS),
    ]
    imu = ScriptedSource("imu", script, opens=[None, DriverError("imu: not there"), None])
    result = record(path, [imu, tracker(poses(200))])
    messages, metadata = read(path)
    assert len(of_type(messages, PoseSample)) == 200
    found = of_type(messages, AccelerationSample)
    assert [s.sequence for s in found] == list(range(60))
    assert imu.opened == 3
    told = json.loads(metadata[STATISTICS_NAME]["source.imu"])
    assert told["losses"] == 1
    (stream,) = told["streams"]
    assert (stream["statistics"]["gaps"], stream["statistics"]["missed"]) == (1, 0)
    assert stream["statistics"]["gap_s"] == pytest.approx(0.471)
    assert [f.topic for f in check(path) if f.kind == "gap"] == ["/acceleration"]
    assert result.outcome == "ended"


@pytest.mark.parametrize("pulled", [type(make(0)) for make in MAKERS])
def test_whichever_source_is_pulled_out_the_others_lose_nothing(
    tmp_path: Path, pulled: type[Sample]
) -> None:
    def script(make: Callable[[int, int], Sample], kind: type[Sample]) -> Iterator[Step]:
        for i in range(20):
            yield [make(i, i * MS)]
        if kind is pulled:
            yield DriverError("pulled out")
            for i in range(20):  # it counts from 0 again
                yield [make(i, (120 + i) * MS)]
        else:
            for i in range(20, 140):
                yield [make(i, i * MS)]

    sources = [
        ScriptedSource(kind.__name__, script(make, kind), produces=(kind,), rates_hz={kind: 1000.0})
        for make, kind in ((make, type(make(0))) for make in MAKERS)
    ]
    result = record(tmp_path / "r.mcap", sources)
    messages, _ = read(tmp_path / "r.mcap")
    gaps_s = {t.topic: t.largest_gap_s for t in inspect(tmp_path / "r.mcap").topics}
    for source, health in zip(sources, result.health.sources, strict=True):
        (kind,) = source.open().produces
        (stream,) = health.streams
        was_pulled = kind is pulled
        found = [sample.sequence for sample in of_type(messages, kind)]
        assert found == list(range(40 if was_pulled else 140))
        assert health.losses == stream.statistics.gaps == int(was_pulled)
        assert stream.statistics.missed == health.queue.dropped == 0
        assert gaps_s[stream.topic] == pytest.approx(0.101 if was_pulled else 0.001)


@pytest.mark.parametrize("defect", [ValueError("bad byte"), IndexError("9"), OSError(5, "EIO")])
def test_a_defect_in_a_driver_is_that_sources_own(tmp_path: Path, defect: Exception) -> None:
    path = tmp_path / "r.mcap"
    imu = ScriptedSource("imu", [*accelerations(0, 3), defect, *accelerations(3, 5)])
    result = record(path, [imu, tracker(poses(20))])
    messages, _ = read(path)
    assert len(of_type(messages, PoseSample)) == 20
    assert len(of_type(messages, AccelerationSample)) == 5
    assert result.health.sources[0].losses == 1


def test_what_finds_no_room_is_counted_and_visible(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    batch: list[Step] = [[acceleration(i, i * MS) for i in range(50)], [acceleration(50, 50 * MS)]]
    narrow = WorkerSettings(queue_limit_bytes=20 * 1024, read_timeout_s=0.01)
    plan = RecordingPlan(flush_interval_s=0.002, worker=narrow)
    result = record(path, [ScriptedSource("imu", batch)], plan)
    messages, metadata = read(path)
    kept = [s.sequence for s in of_type(messages, AccelerationSample)]
    dropped = result.health.sources[0].queue.dropped
    assert kept[:20] == list(range(20))
    assert dropped == 51 - len(kept) >= 30
    assert json.loads(metadata[STATISTICS_NAME]["source.imu"])["queue"]["dropped"] == dropped
    last = of_type(messages, Diagnostics)[-1].statuses[1]
    assert last.values["dropped"] == str(dropped)


def test_what_a_driver_lost_is_told_by_the_recording(tmp_path: Path) -> None:
    """What `open` met does not count, and a source that was pulled out goes on counting."""
    path = tmp_path / "r.mcap"
    unplugged: list[Step] = [DriverError("imu: unplugged")]
    script = [*accelerations(0, 2), *unplugged, *accelerations(2, 6)]
    counted = [1, 2, 4, 0, 1, 5]
    source = ScriptedSource(
        "imu", script, faults=[Faults({"garbage_bytes": n}, {"retries": n}) for n in counted]
    )
    result = record(path, [source])
    (health,) = result.health.sources
    # 4 before it was lost; then from the 4 that it shows when it is open again to 5.
    assert health.faults == Faults({"garbage_bytes": 5}, {"retries": 5})
    assert inspect(path).faults == {"imu": health.faults}
    assert "  imu lost: 5 garbage bytes" in inspect(path).describe()
    assert "  imu mended: 5 retries" in inspect(path).describe()
    (found,) = [finding for finding in check(path) if finding.kind == "device"]
    assert found.describe() == "device: imu: its driver counted 5 garbage bytes"


def test_a_source_that_is_late_joins_the_recording(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    stop = Event()
    late = tracker([*poses(5), stop.set], opens=[DriverError("tracker: off")] * 3, goes_on=True)
    result = record(path, [ScriptedSource("imu", accelerations(0, 5)), late], stop=stop)
    assert result.outcome == "stopped"
    messages, metadata = read(path)
    assert len(of_type(messages, PoseSample)) == 5
    assert "source.tracker" in metadata["terravibe"]


def test_a_late_source_that_would_mix_with_another_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    stop = Event()
    twin = ScriptedSource("twin", accelerations(0, 5), opens=[DriverError("twin: off")] * 100)
    imu = ScriptedSource("imu", accelerations(0, 5), goes_on=True)
    recorder = Recorder([imu, twin], output(path), QUICK, SecondsClock())

    def beat(snapshot: HealthSnapshot) -> None:
        if snapshot.sources[1].state == "refused":
            stop.set()

    result = recorder.run(stop, beat)
    assert result.health.sources[1].state == "refused"
    assert "imu and twin both produce" in result.health.sources[1].error


def test_required_sources_must_all_be_there(tmp_path: Path) -> None:
    gone = tracker([], opens=[DriverError("tracker: no server at 10.0.0.1")])
    imu = ScriptedSource("imu", [])
    plan = RecordingPlan(require_all=True)
    with pytest.raises(RecorderError, match=r"1 of 2 sources are missing: tracker: no server"):
        Recorder([imu, gone], output(tmp_path / "r.mcap"), plan).run(Event())
    assert imu.closed >= 1
    assert not list(tmp_path.iterdir())


def test_nothing_to_record_is_an_error_with_every_reason(tmp_path: Path) -> None:
    sources = [
        ScriptedSource("imu", [], opens=[DriverError("imu: no device")]),
        tracker([], opens=[DriverError("tracker: no server")]),
    ]
    with pytest.raises(RecorderError, match=r"2 of 2 .* imu: no device; tracker: no server"):
        record(tmp_path / "r.mcap", sources, RecordingPlan())


def test_live_and_recorded_times_do_not_mix(tmp_path: Path) -> None:
    sources = [ScriptedSource("imu", []), tracker([], time_base="recorded")]
    with pytest.raises(RecorderError, match="record them separately"):
        record(tmp_path / "r.mcap", sources)


@pytest.mark.parametrize("names", [[], ["imu", "imu"]])
def test_every_source_needs_a_name(tmp_path: Path, names: list[str]) -> None:
    with pytest.raises(RecorderError, match="at least one, and a name"):
        Recorder([ScriptedSource(name, []) for name in names], output(tmp_path / "r.mcap"))


def test_a_driver_that_hangs_does_not_hold_up_the_end(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    released, stop = Event(), Event()

    def hang() -> None:
        stop.set()
        released.wait(10.0)

    imu = ScriptedSource("imu", [*accelerations(0, 5), hang], goes_on=True)
    plan = replace(QUICK, stop_timeout_s=0.05)
    recorder = Recorder([imu, tracker(poses(5))], output(path), plan, FixedClock())
    result = recorder.run(stop)
    released.set()
    assert recorder._workers[0].join(5.0)
    assert result.hanging == ("imu",)
    messages, _ = read(path)
    assert len(of_type(messages, AccelerationSample)) == 5


def test_preflight_reports_every_source_and_closes_it() -> None:
    sources = [
        ScriptedSource("imu", []),
        tracker([], opens=[DriverError("tracker: no server at 10.0.0.1; is it on?")]),
    ]
    report = preflight(sources)
    assert report.describe() == [
        "ready imu: script imu-1",
        "missing tracker: no server at 10.0.0.1; is it on?",
    ]
    assert [check.name for check in report.missing] == ["tracker"]
    assert sources[0].closed >= 1


def test_preflight_does_not_wait_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    released = Event()
    imu = ScriptedSource("imu", [])
    info = imu.open()

    def hang() -> SourceInfo:
        released.wait(10.0)
        return info

    monkeypatch.setattr(imu, "open", hang)
    workers = [SourceWorker(imu, FixedClock(), WorkerSettings())]
    report = try_all(workers, 0.02)
    released.set()
    assert report.describe() == ["missing imu: no answer within 0.02 s"]
    assert stop_all(workers, 5.0) == []


def test_a_recorder_that_was_only_checked_is_closed(tmp_path: Path) -> None:
    imu = ScriptedSource("imu", [])
    recorder = Recorder([imu], output(tmp_path / "r.mcap"))
    recorder.preflight()
    recorder.close()
    assert imu.closed >= 1
    assert not list(tmp_path.iterdir())
