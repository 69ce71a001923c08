"""Byte sources: a finished file, a growing one without any real waiting, a pipe."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Any

import pytest

from acquisition.errors import StreamError
from acquisition.stream.byte_source import FinishedFile, GrowingFile, Pipe, standard_input
from acquisition.stream.reader import StreamReader
from tests.fakes.recordings import fingerprint, reader_of, recording, samples


class GrowingInSleep:
    """Stands for a recorder: appends the next piece whenever the follower sleeps."""

    def __init__(self, path: Path, pieces: list[bytes]) -> None:
        self._path = path
        self._pieces = pieces
        self.slept_s: list[float] = []
        path.touch()

    def __call__(self, seconds: float) -> None:
        self.slept_s.append(seconds)
        if self._pieces:
            with self._path.open("ab") as file:
                file.write(self._pieces.pop(0))


def test_a_follower_hands_on_what_a_finished_file_gives(tmp_path: Path) -> None:
    data = recording(samples(0.5), flush_interval_ns=10**7)
    pieces = [data[i : i + 997] for i in range(0, len(data), 997)]
    grow = GrowingInSleep(tmp_path / "r.mcap", pieces)
    with GrowingFile(tmp_path / "r.mcap", sleep=grow) as file:
        reader = StreamReader(file)
        followed = fingerprint(list(reader))
    assert followed == fingerprint(list(reader_of(data)))
    assert reader.report.complete
    assert len(grow.slept_s) >= len(data) // 997


def follow_half(path: Path, **options: Any) -> StreamReader:
    """Follow a recorder that died halfway; return the reader after its end."""
    data = recording(samples(0.5), flush_interval_ns=10**7)
    grow = GrowingInSleep(path, [data[: len(data) // 2]])
    with GrowingFile(path, sleep=grow, **options) as file:
        reader = StreamReader(file)
        assert list(reader)
    assert not reader.report.complete
    assert reader.report.truncated_bytes > 0
    return reader


def test_silence_ends_the_following_of_a_dead_recorder(tmp_path: Path) -> None:
    follow_half(tmp_path / "r.mcap", idle_timeout_s=1.0, poll_interval_s=0.25)


def test_a_stop_ends_the_following(tmp_path: Path) -> None:
    looks = iter([False, False, False, True])
    follow_half(tmp_path / "r.mcap", stop=lambda: next(looks))
    assert next(looks, None) is None


def test_silence_is_counted_anew_after_each_byte(tmp_path: Path) -> None:
    grow = GrowingInSleep(tmp_path / "f", [b"", b"a", b"", b"b", b"", b"", b""])
    with GrowingFile(tmp_path / "f", sleep=grow, idle_timeout_s=0.75, poll_interval_s=0.25) as file:
        assert [file.read(10) for _ in range(3)] == [b"a", b"b", b""]
    assert len(grow.slept_s) == 7


def test_a_file_that_is_written_anew_while_followed_is_told(tmp_path: Path) -> None:
    path = tmp_path / "f"
    path.write_bytes(b"0123456789")

    def start_again(seconds: float) -> None:
        path.write_bytes(b"01")

    with GrowingFile(path, sleep=start_again) as file:
        assert file.read(100) == b"0123456789"
        with pytest.raises(StreamError, match="became shorter"):
            file.read(100)


def test_a_pipe_hands_on_what_is_there_without_waiting_for_more() -> None:
    read_end, write_end = os.pipe()
    with os.fdopen(read_end, "rb") as stream, os.fdopen(write_end, "wb", buffering=0) as out:
        out.write(b"abc")
        pipe = Pipe(stream)
        assert pipe.read(100) == b"abc"
        out.write(b"def")
        out.close()
        assert pipe.skip_rest() == 3
        assert pipe.read(100) == b""


def test_standard_input_is_read_as_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    data = recording(samples(0.1))
    with io.TextIOWrapper(io.BytesIO(data)) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        assert fingerprint(StreamReader(standard_input())) == fingerprint(reader_of(data))


def test_a_terminal_is_no_recording(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal, other_end = os.openpty()
    with os.fdopen(terminal, "rb"), os.fdopen(other_end) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        with pytest.raises(StreamError, match="is a terminal"):
            standard_input()


def test_a_broken_pipe_is_one_line() -> None:
    class Broken(io.BytesIO):
        def read1(self, size: int | None = -1, /) -> bytes:
            raise OSError(5, "Input/output error")

    with pytest.raises(StreamError, match="cannot read the socket: Input/output error"):
        Pipe(Broken(), "the socket").read(1)


@pytest.mark.parametrize(("name", "reason"), [("no.mcap", "No such file"), (".", "directory")])
def test_a_file_that_cannot_be_opened_is_one_line(tmp_path: Path, name: str, reason: str) -> None:
    with pytest.raises(StreamError, match=f"cannot read .*{reason}"):
        FinishedFile(tmp_path / name)
