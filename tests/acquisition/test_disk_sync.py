"""What a power cut may take: files are synchronised while they are written and when they end."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from threading import Event

import pytest

from acquisition.recording.disk_sync import DiskSync


def test_current_and_finished_files_are_synchronised(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[Path] = []
    twice = Event()

    def note(path: Path, flags: int) -> None:
        if not flags & os.O_DIRECTORY:
            done.append(path)
        if len(done) >= 4:
            twice.set()

    monkeypatch.setattr("acquisition.recording.disk_sync.synchronise", note)
    sync = DiskSync(0.001)
    first, second = tmp_path / "a", tmp_path / "b"
    sync.follow(first)
    sync.follow(second)
    assert twice.wait(10.0)
    sync.close()
    assert done.count(first) >= 1
    assert done.count(second) >= 2


def test_what_a_disk_refused_once_stays_told_and_does_not_end_the_thread(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The system says once that what was written is lost; after that, all seems well."""
    calls: list[Path] = []
    again = Event()

    def refuse_once(path: Path, _flags: int) -> None:
        calls.append(path)
        if len(calls) == 1:
            raise OSError(errno.EIO, "Input/output error")
        again.set()

    monkeypatch.setattr("acquisition.recording.disk_sync.synchronise", refuse_once)
    sync = DiskSync(0.001)
    sync.follow(tmp_path / "a")
    assert again.wait(10.0)
    sync.close()
    assert sync.error == f"cannot synchronise {tmp_path / 'a'}: Input/output error"


def test_a_file_that_was_removed_is_no_problem(tmp_path: Path) -> None:
    sync = DiskSync(60.0)
    sync.follow(tmp_path / "gone")
    sync.forget()
    sync.close()
    assert sync.error == ""
