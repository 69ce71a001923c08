"""The recorder: one stream in order of log time, and an end that loses nothing unnoticed."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import chain, repeat
from pathlib import Path
from threading import Event

import numpy as np
import pytest

from acquisition.clocks.clock_sample import ClockSample
from acquisition.clocks.host_clock import HostClock
from acquisition.errors import StreamError
from acquisition.health.diagnostics import Diagnostics
from acquisition.recording.disk_output import DiskOutput
from acquisition.recording.folder_store import DiskSettings
from acquisition.recording.recorder import Recorder
from acquisition.recording.ring_output import RingOutput, RingSettings
from acquisition.stream.byte_source import FinishedFile
from acquisition.stream.parts import read_parts
from acquisition.stream.reader import StreamReader
from acquisition.stream.split_writer import STATISTICS_NAME
from drivers.samples import AccelerationSample, DepthFrame
from tests.acquisition.test_stream_writer import files_may_grow_to
from tests.fakes.clocks import FakeHost
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
from tests.fakes.recordings import START_NS, acceleration, depth_frame
from tests.fakes.scripted_source import ScriptedSource, Step


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


def test_an_older_recording_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(StreamError, match="exists already"):
        record(path, [ScriptedSource("imu", [])])
    assert path.read_bytes() == b"precious"


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
