"""The recorder: every source at its own pace and peril, one stream, nothing lost unnoticed."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import chain, count, repeat
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest

from acquisition.clocks.clock_sample import ClockSample
from acquisition.clocks.host_clock import HostClock
from acquisition.errors import RecorderError, StreamError
from acquisition.health.diagnostics import Diagnostics
from acquisition.health.snapshot import HealthSnapshot
from acquisition.inspection import check, inspect
from acquisition.recording.disk_output import DiskOutput
from acquisition.recording.folder_store import DiskSettings
from acquisition.recording.plan import RecordingPlan, RecordingResult
from acquisition.recording.preflight import preflight, stop_all, try_all
from acquisition.recording.recorder import Recorder
from acquisition.recording.ring_output import RingOutput, RingSettings
from acquisition.recording.source_worker import SourceWorker, WorkerSettings
from acquisition.stream.byte_source import FinishedFile
from acquisition.stream.parts import read_parts
from acquisition.stream.reader import StreamMessage, StreamReader
from acquisition.stream.split_writer import STATISTICS_NAME
from drivers.errors import DriverError
from drivers.faults import Faults
from drivers.samples import AccelerationSample, DepthFrame, PoseSample, Sample
from drivers.source import SourceInfo
from tests.acquisition.test_stream_writer import files_may_grow_to
from tests.fakes.clocks import FakeHost
from tests.fakes.device_samples import MAKERS
from tests.fakes.recordings import MOUNT, START_NS, acceleration, depth_frame, pose
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


def test_depth_may_be_recorded_under_rvl(tmp_path: Path) -> None:
    frames = [[depth_frame(i, i * 33 * MS)] for i in range(3)]
    camera = ScriptedSource("camera", frames, produces=(DepthFrame,))
    record(tmp_path / "r.mcap", [camera], replace(QUICK, depth_format="rvl"))
    messages, _ = read(tmp_path / "r.mcap")
    found = [message for message in messages if isinstance(message.sample, DepthFrame)]
    assert {message.topic for message in found} == {"/depth/image/compressedDepth"}
    for message, (frame,) in zip(found, frames, strict=True):
        assert isinstance(message.sample, DepthFrame)
        assert np.array_equal(message.sample.depth_mm, frame.depth_mm)


def test_all_sources_end_up_in_one_file_in_order_of_log_time(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    frames = [[depth_frame(i, i * 33 * MS)] for i in range(3)]
    camera = ScriptedSource("camera", frames, produces=(DepthFrame,))
    sources = [ScriptedSource("imu", accelerations(0, 100)), tracker(poses(50)), camera]
    result = record(path, sources)
    assert (result.outcome, result.unwritten, result.hanging) == ("ended", 0, ())
    assert result.files == (path,)
    messages, metadata = read(path)
    counts = Counter(message.topic for message in messages)
    assert (counts["/acceleration"], counts["/mocap/pose"], counts["/depth/image"]) == (100, 50, 3)
    assert counts["/diagnostics"] >= 1
    assert [s.sequence for s in of_type(messages, AccelerationSample)] == list(range(100))
    assert json.loads(metadata["terravibe"]["settings"]) == {"rover": "test"}
    assert all(source.closed >= 1 for source in sources)


def test_stamps_of_live_sources_become_log_time(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    record(path, [ScriptedSource("imu", accelerations(0, 3))])
    messages, _ = read(path)
    found = [m for m in messages if isinstance(m.sample, AccelerationSample)]
    assert [m.log_time_ns for m in found] == [START_NS + i * MS for i in range(3)]
    assert [m.sample.t_ns for m in found] == [m.log_time_ns for m in found]


def test_recorded_times_stay_as_they_are(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    record(path, [ScriptedSource("imu", accelerations(0, 3, 5), time_base="recorded")])
    messages, _ = read(path)
    assert [s.t_ns for s in of_type(messages, AccelerationSample)] == [5, 5 + MS, 5 + 2 * MS]


def test_stop_writes_what_is_in_the_queues(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    stop = Event()
    imu = ScriptedSource("imu", [*accelerations(0, 40), stop.set], goes_on=True)
    result = record(path, [imu], replace(QUICK, flush_interval_s=60.0), stop)
    assert result.outcome == "stopped"
    messages, _ = read(path)
    assert len(of_type(messages, AccelerationSample)) == 40


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


def test_a_sample_that_no_message_can_express_is_counted(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    bad = AccelerationSample(MS, np.array([np.nan, 0.0, 0.0]), 1)
    script: list[Step] = [[acceleration(0, 0)], [bad], [acceleration(2, 2 * MS)]]
    result = record(path, [ScriptedSource("imu", script)])
    messages, _ = read(path)
    assert [s.sequence for s in of_type(messages, AccelerationSample)] == [0, 2]
    assert result.health.sources[0].streams[0].refused == 1
    assert "not finite" in result.health.warnings[0]
    assert result.unwritten == 0


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


def test_an_older_recording_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(StreamError, match="exists already"):
        record(path, [ScriptedSource("imu", [])])
    assert path.read_bytes() == b"precious"


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


def test_the_heartbeat_gets_every_snapshot(tmp_path: Path) -> None:
    seen: list[object] = []
    stop = Event()
    imu = ScriptedSource("imu", accelerations(0, 3), goes_on=True)
    recorder = Recorder([imu], output(tmp_path / "r.mcap"), QUICK, SecondsClock())

    def beat(snapshot: object) -> None:
        seen.append(snapshot)
        assert recorder.snapshot is snapshot
        if len(seen) == 3:
            stop.set()

    recorder.run(stop, beat)
    assert len(seen) >= 3


def test_a_full_disk_ends_the_recording_well_and_says_so(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    free = chain([10**9] * 4, repeat(0))
    full = DiskOutput(path, DiskSettings(reserve_bytes=10**6), free=lambda _: next(free))
    imu = ScriptedSource("imu", accelerations(0, 50), goes_on=True)
    result = Recorder([imu], full, QUICK, SecondsClock()).run(Event())
    assert result.outcome == "output_failed"
    assert "0 MB left, the reserve is 1 MB" in result.message
    assert result.files == (path,)
    messages, metadata = read(path)
    assert len(of_type(messages, AccelerationSample)) + result.unwritten == 50
    assert STATISTICS_NAME in metadata


def test_a_disk_that_fails_counts_what_was_not_written(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    script = [[acceleration(i, i * MS) for i in range(100 * k, 100 * k + 100)] for k in range(200)]
    imu = ScriptedSource("imu", script)
    with files_may_grow_to(120_000):
        result = record(path, [imu])
    assert result.outcome == "output_failed"
    assert "File too large" in result.message
    with FinishedFile(path) as file:
        reader = StreamReader(file)
        flushed = of_type(list(reader), AccelerationSample)
    assert (reader.report.truncated_bytes, reader.report.damaged) == (0, ())
    (stream,) = result.health.sources[0].streams
    told = stream.statistics.samples + result.health.sources[0].queue.samples
    assert 100 < len(flushed) < told
    assert [s.sequence for s in flushed] == list(range(len(flushed)))
    # Diagnostics may be among what was not written, so the samples are at most as many.
    assert told - len(flushed) <= result.unwritten <= told - len(flushed) + 1


def test_the_ring_writes_what_came_before_the_trigger(tmp_path: Path) -> None:
    ring = RingOutput(tmp_path / "r.mcap", RingSettings(60 * 10**9, reserve_bytes=0))
    stop = Event()
    imu = ScriptedSource("imu", [*accelerations(0, 30), ring.trigger, stop.set], goes_on=True)
    result = Recorder([imu], ring, QUICK, FixedClock()).run(stop)
    assert result.outcome == "stopped"
    found = [message.sample for message in read_parts(result.files)]
    assert [s.sequence for s in found if isinstance(s, AccelerationSample)] == list(range(30))
    assert result.files[0].name == "r_snap000.mcap"


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


def test_the_clocks_of_the_host_are_recorded_in_log_time(tmp_path: Path) -> None:
    result = record(tmp_path / "run.mcap", [ScriptedSource("imu", accelerations(0, 3))])
    messages, _ = read(result.files[0])
    clocks = of_type(messages, ClockSample)
    assert [(clock.t_ns, clock.sequence, clock.boot_id) for clock in clocks] == [
        (START_NS, 0, "boot")
    ]


def test_steps_of_the_clock_and_a_suspend_are_told_and_move_no_stamp(tmp_path: Path) -> None:
    host, beat = FakeHost(), Event()
    hour_ns = 3600 * 10**9

    def step(amount_ns: int) -> None:
        host.real_offset_ns += amount_ns

    moves: list[Callable[[], None]] = [
        lambda: None,
        lambda: step(hour_ns),
        lambda: step(-hour_ns),
        lambda: host.suspend(90 * 10**9),
    ]

    def script() -> Iterator[Step]:
        for number, move in enumerate(moves):
            beat.clear()
            move()
            host.monotonic_ns += 10**9
            yield [acceleration(number, host.monotonic_ns)]
            assert beat.wait(10.0)  # the recorder has looked at the clocks

    clock, path = HostClock(host.clocks), tmp_path / "r.mcap"
    began_ns = clock.log_time_ns(clock.monotonic_ns())
    recorder = Recorder([ScriptedSource("imu", script())], output(path), QUICK, clock)
    recorder.run(Event(), lambda _: beat.set())
    messages, _ = read(path)
    assert [s.t_ns for s in of_type(messages, AccelerationSample)] == [
        began_ns + number * 10**9 for number in (1, 2, 3, 4)
    ]
    log_times_ns = [message.log_time_ns for message in messages]
    assert log_times_ns == sorted(log_times_ns)
    told = [(c.event, c.event_ns) for c in of_type(messages, ClockSample) if c.event]
    steps = [("real_time_step", hour_ns), ("real_time_step", -hour_ns)]
    assert told == [*steps, ("suspend", 90 * 10**9)]


def test_a_replayed_recording_keeps_to_its_own_times(tmp_path: Path) -> None:
    replayed = ScriptedSource("again", accelerations(0, 3), time_base="recorded")
    messages, _ = read(record(tmp_path / "run.mcap", [replayed]).files[0])
    assert not of_type(messages, ClockSample)
    assert [health.t_ns for health in of_type(messages, Diagnostics)] == [2 * MS]
