"""The writer: what is in the file and when, and what happens when the disk says no."""

from __future__ import annotations

import errno
import io
import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader as McapStreamReader

from acquisition.errors import StreamError
from acquisition.health.diagnostics import DeviceStatus, Diagnostics, Level
from acquisition.messages import codec
from acquisition.stream.byte_source import FinishedFile
from acquisition.stream.reader import StreamReader
from acquisition.stream.writer import StreamWriter
from drivers.samples import AccelerationSample, PoseSample
from drivers.source import SourceInfo
from tests.fakes.recordings import (
    MOUNT,
    SETTINGS,
    SOURCE,
    START_NS,
    acceleration,
    depth_frame,
    pose,
    reader_of,
    recording,
    samples,
)

ACCELEROMETER = SourceInfo("imu", "chip", "", (AccelerationSample,), "recorded")
POSES = SourceInfo("tracker", "mocap", "", (PoseSample,), "recorded")


def writer(output: Any, **options: Any) -> StreamWriter:
    arguments: dict[str, Any] = {
        "sources": [SOURCE],
        "static_transforms": [MOUNT],
        "settings": SETTINGS,
    }
    return StreamWriter(output, **(arguments | options))


def records(data: bytes) -> list[McapRecord]:
    return list(McapStreamReader(io.BytesIO(data), emit_chunks=True, validate_crcs=True).records)


def test_provenance_then_definitions_then_the_first_chunk() -> None:
    kinds = [type(record) for record in records(recording([depth_frame(0)]))]
    first_chunk = kinds.index(Chunk)
    assert kinds.index(Metadata) == 1
    assert kinds[2:first_chunk].count(Schema) == 7
    assert kinds[2:first_chunk].count(Channel) == 7


def test_static_transforms_come_first_at_the_time_of_the_first_sample() -> None:
    stream = io.BytesIO(recording([pose(0), pose(1, START_NS + 1)]))
    found = list(McapStreamReader(stream, validate_crcs=True).records)
    topics = {record.id: record.topic for record in found if isinstance(record, Channel)}
    messages = [record for record in found if isinstance(record, Message)]
    assert [topics[m.channel_id] for m in messages] == ["/tf_static", "/mocap/pose", "/mocap/pose"]
    assert messages[0].log_time == START_NS


def test_a_follower_sees_what_is_older_than_the_flush_interval(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    with writer(path) as stream:
        for number in range(11):
            stream.write(pose(number, START_NS + number * 10_000_000))
        with FinishedFile(path) as file:
            seen = [message.sequence for message in StreamReader(file)]
    assert seen == [0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10]


def test_the_log_time_may_differ_from_the_sample_time() -> None:
    stream = io.BytesIO()
    with writer(stream) as out:
        out.write(pose(0), log_time_ns=5)
    found = records(stream.getvalue())
    assert next(r for r in found if isinstance(r, Chunk)).message_end_time == 5


def test_a_recording_without_samples_is_complete() -> None:
    assert records(recording([]))[-1]


def test_it_writes_to_a_pipe() -> None:
    read_end, write_end = os.pipe()
    with os.fdopen(write_end, "wb") as out, writer(out) as stream:
        stream.write(pose(0))
    with os.fdopen(read_end, "rb") as pipe:
        data = pipe.read()
    assert data == recording([pose(0)])


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"settings": {"x": {1, 2}}}, "cannot record settings as JSON"),
        ({"settings": {"x": float("nan")}}, "cannot record settings as JSON"),
        ({"sources": [SOURCE, POSES]}, "fake and tracker both produce PoseSample"),
    ],
)
def test_it_refuses_to_start_with_nonsense(
    tmp_path: Path, options: dict[str, Any], reason: str
) -> None:
    with pytest.raises(StreamError, match=reason):
        writer(tmp_path / "r.mcap", **options)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("log_time_ns", [-1, 2**64])
def test_it_refuses_an_impossible_log_time(log_time_ns: int) -> None:
    with writer(io.BytesIO()) as stream, pytest.raises(StreamError, match="log time"):
        stream.write(pose(0), log_time_ns)


def test_it_refuses_a_sample_that_was_not_announced() -> None:
    with (
        writer(io.BytesIO(), sources=[POSES]) as stream,
        pytest.raises(StreamError, match="no source of this recording produces DepthFrame"),
    ):
        stream.write(depth_frame(0))


def test_a_source_that_turns_up_late_is_announced_before_its_samples() -> None:
    stream = io.BytesIO()
    with writer(stream, sources=[ACCELEROMETER]) as out:
        out.write(acceleration(0))
        out.add_source(POSES)
        out.write(pose(0))
    found = records(stream.getvalue())
    late = max(i for i, record in enumerate(found) if isinstance(record, Chunk))
    before = [r.topic for r in found[:late] if isinstance(r, Channel)]
    assert before.count("/mocap/pose") == 1
    reader = reader_of(stream.getvalue())
    assert [message.topic for message in reader] == ["/tf_static", "/acceleration", "/mocap/pose"]
    assert {"source.tracker", "source.imu", "settings"} <= set(reader.metadata["terravibe"])


def test_a_late_source_of_a_type_that_is_there_is_refused_and_changes_nothing() -> None:
    stream = io.BytesIO()
    with writer(stream) as out:
        with pytest.raises(StreamError, match="fake and tracker both produce PoseSample"):
            out.add_source(POSES)
        out.write(pose(0))
    assert "source.tracker" not in reader_metadata(stream.getvalue())


def reader_metadata(data: bytes) -> dict[str, str]:
    reader = reader_of(data)
    list(reader)
    return reader.metadata["terravibe"]


def test_the_writing_program_may_say_something_itself() -> None:
    said = Diagnostics(START_NS, (DeviceStatus(Level.OK, "fake", "well", "7", {"a": "b"}),))
    stream = io.BytesIO()
    with writer(stream, extra_types=[Diagnostics], static_transforms=[]) as out:
        size_bytes = out.write(said)
        out.add_metadata("end", {"losses": "0"})
    reader = reader_of(stream.getvalue())
    assert [message.sample for message in reader] == [said]
    assert reader.metadata["end"] == {"losses": "0"}
    assert size_bytes == len(codec.encode(said)[0].cdr)


def test_it_refuses_to_write_when_closed() -> None:
    stream = writer(io.BytesIO())
    stream.close()
    stream.close()
    with pytest.raises(StreamError, match="closed"):
        stream.write(pose(0))


@pytest.mark.parametrize("name", ["no/such/folder.mcap", "."])
def test_a_path_that_cannot_be_opened_is_one_line(tmp_path: Path, name: str) -> None:
    with pytest.raises(StreamError, match="cannot write") as caught:
        writer(tmp_path / name)
    assert str(tmp_path) in str(caught.value)


def test_a_full_disk_is_one_line() -> None:
    with pytest.raises(StreamError, match="cannot write /dev/full after 0 bytes: No space left"):
        writer(Path("/dev/full"))


@contextmanager
def files_may_grow_to(size_bytes: int) -> Iterator[None]:
    """Let the kernel tear a write at that size, as a full disk does."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def write_all(stream: StreamWriter) -> None:
    for sample in samples(1.0):
        stream.write(sample)


def test_after_a_torn_write_the_file_ends_behind_its_last_whole_record(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    size_bytes = len(recording(samples(1.0))) // 2
    with files_may_grow_to(size_bytes), writer(path) as stream:
        with pytest.raises(StreamError, match="File too large"):
            write_all(stream)
        with pytest.raises(StreamError, match="has failed"):
            stream.write(pose(0))
    assert path.stat().st_size <= size_bytes
    with FinishedFile(path) as file:
        reader = StreamReader(file)
        messages = list(reader)
    assert len(messages) > 10
    assert (reader.report.truncated_bytes, reader.report.damaged) == (0, ())
    assert not reader.report.complete


class Unplugged(io.FileIO):
    """A file on a stick that was pulled out, under a file system that says so on closing."""

    def close(self) -> None:
        was_open = not self.closed
        super().close()
        if was_open:
            raise OSError(errno.EIO, os.strerror(errno.EIO))


@pytest.mark.parametrize("written", [True, False])
def test_a_file_that_cannot_be_closed_is_told_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, written: bool
) -> None:
    path = tmp_path / "r.mcap"
    monkeypatch.setattr(Path, "open", lambda path, *_, **__: Unplugged(str(path), "wb"))
    stream = writer(path)
    if written:
        with pytest.raises(StreamError, match=r"cannot close .*r\.mcap: Input/output error"):
            stream.close()
        return
    with files_may_grow_to(stream.bytes_written), pytest.raises(StreamError, match="too large"):
        write_all(stream)
    stream.close()


def test_a_disk_that_fills_up_while_closing_is_told(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    stream = writer(path, flush_interval_ns=10**12)
    head_bytes = path.stat().st_size
    write_all(stream)
    with files_may_grow_to(head_bytes + 100), pytest.raises(StreamError, match="File too large"):
        stream.close()
    assert path.stat().st_size == head_bytes


def test_a_pipe_whose_reader_has_gone_is_one_line() -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    with (
        os.fdopen(write_end, "wb", buffering=0) as out,
        pytest.raises(StreamError, match="Broken pipe"),
    ):
        writer(out)
