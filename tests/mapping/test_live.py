"""Recording and mapping at once: the same map as afterwards, and no half a recording unnoticed."""

from __future__ import annotations

from pathlib import Path

import pytest

from acquisition.errors import RecorderError, StreamError
from acquisition.messages.frames import camera_is_tracked_body
from acquisition.recording.plan import RecordingPlan
from acquisition.recording.source_worker import WorkerSettings
from acquisition.stream.byte_source import FinishedFile
from acquisition.stream.reader import StreamReader
from drivers.errors import DriverError
from drivers.samples import PoseSample
from mapping.errors import MappingError
from mapping.live import record_and_map
from mapping.session import MapOptions, map_stream
from mapping.settings import MapSettings
from simulation.ideal_drive import IdealDrive
from tests.acquisition.test_stream_writer import files_may_grow_to
from tests.fakes.recordings import pose
from tests.fakes.scripted_source import ScriptedSource

OPTIONS = MapOptions(MapSettings())


def plan(queue_limit_bytes: int = 1 << 28) -> RecordingPlan:
    worker = WorkerSettings(queue_limit_bytes=queue_limit_bytes, read_timeout_s=0.01)
    return RecordingPlan([camera_is_tracked_body()], flush_interval_s=0.005, worker=worker)


def test_the_live_map_is_the_map_of_the_finished_file(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    live = record_and_map(IdealDrive(1, 0.5), path, plan(), OPTIONS)
    with FinishedFile(path) as file:
        reader = StreamReader(file)
        again = map_stream(reader, OPTIONS)
        assert reader.report.complete
    assert live.counts.frames == 5
    assert live.map.sha256() == again.map.sha256()


def test_samples_without_room_are_no_recording(tmp_path: Path) -> None:
    with pytest.raises(StreamError, match="ideal_drive: 5 samples found no room"):
        record_and_map(IdealDrive(1, 0.5), tmp_path / "r.mcap", plan(100_000), OPTIONS)


def test_a_full_disk_is_told_and_not_what_follows_from_it(tmp_path: Path) -> None:
    with files_may_grow_to(20_000), pytest.raises(StreamError, match="File too large"):
        record_and_map(IdealDrive(1, 0.5), tmp_path / "r.mcap", plan(), OPTIONS)


def test_an_older_recording_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    path.write_bytes(b"older")
    with pytest.raises(StreamError, match="exists already"):
        record_and_map(IdealDrive(1, 0.5), path, plan(), OPTIONS)
    assert path.read_bytes() == b"older"


def test_a_source_that_does_not_open_is_told(tmp_path: Path) -> None:
    source = ScriptedSource("rover", [], opens=[DriverError("rover: fell over")] * 9)
    with pytest.raises(RecorderError, match="rover: fell over"):
        record_and_map(source, tmp_path / "r.mcap", plan(), OPTIONS)
    assert list(tmp_path.iterdir()) == []


def test_when_mapping_fails_the_recording_ends_well(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    source = ScriptedSource(
        "tracker",
        [[pose(0, 0)]],
        produces=(PoseSample,),
        time_base="recorded",
        goes_on=True,
    )

    def fail(message: object) -> None:
        raise MappingError("no use")

    with pytest.raises(MappingError, match="no use"):
        record_and_map(source, path, plan(), OPTIONS, fail)
    with FinishedFile(path) as file:
        reader = StreamReader(file)
        assert [type(message.sample) for message in reader].count(PoseSample) == 1
        assert reader.report.complete
