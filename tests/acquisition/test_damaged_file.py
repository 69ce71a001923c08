"""A file on a failing disk: everything is read but the pages that the disk refuses."""

from __future__ import annotations

import errno
import os
import random
from collections import Counter
from pathlib import Path

import pytest

from acquisition.errors import StreamError
from acquisition.recovery.damaged_file import PAGE_BYTES, WINDOW_BYTES, DamagedFile
from acquisition.recovery.salvage import first_pass
from tests.fakes.damage import HEAD, content
from tests.fakes.recordings import recording, samples

BYTES = random.Random(3).randbytes(3 * WINDOW_BYTES + 77)


class FailingDisk:
    """`os.pread` that refuses what touches a bad page, and counts how often it was asked."""

    def __init__(self, *bad_pages: int) -> None:
        self.bad_pages = bad_pages
        self.refused: Counter[int] = Counter()

    def __call__(self, descriptor: int, length: int, offset: int) -> bytes:
        for page in self.bad_pages:
            if offset < (page + 1) * PAGE_BYTES and page * PAGE_BYTES < offset + length:
                self.refused[page] += 1
                raise OSError(errno.EIO, os.strerror(errno.EIO))
        return os.pread(descriptor, length, offset)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "file"
    path.write_bytes(BYTES)
    return path


def test_reads_what_is_there_wherever_it_is(path: Path) -> None:
    chance = random.Random(4)
    with DamagedFile(path) as file:
        assert file.size_bytes == len(BYTES)
        for _ in range(300):
            offset = chance.randrange(len(BYTES))
            length = chance.choice((0, 9, 5000, WINDOW_BYTES, 2 * WINDOW_BYTES))
            if offset + length <= len(BYTES):
                assert file.read(offset, length) == BYTES[offset : offset + length]
            seen = file.peek(offset)
            assert BYTES.startswith(seen, offset)
            assert len(seen) >= min(PAGE_BYTES, len(BYTES) - offset)


def test_the_end_of_the_file_is_told(path: Path) -> None:
    with DamagedFile(path) as file:
        assert file.peek(len(BYTES)) == b""
        for offset, length in ((len(BYTES) - 5, 6), (0, len(BYTES) + 1), (len(BYTES) + 9, 1)):
            with pytest.raises(ValueError, match="the file ends before"):
                file.read(offset, length)


def test_a_page_that_was_refused_is_not_asked_for_again(path: Path) -> None:
    disk = FailingDisk(2, 40)
    with DamagedFile(path, disk) as file:
        for _ in range(20):
            for page in disk.bad_pages:
                start = page * PAGE_BYTES
                with pytest.raises(ValueError, match=f"cannot be read at offset {start}"):
                    file.read(start - 10, 20)
                assert file.read(start - 10, 10) == BYTES[start - 10 : start]
                assert file.peek(start) == b""
                behind = start + PAGE_BYTES
                assert file.read(behind, 100) == BYTES[behind : behind + 100]
    # Once within a long read, once when the page was looked for.
    assert all(count <= 2 for count in disk.refused.values())


def test_only_the_chunks_on_bad_pages_are_lost(tmp_path: Path) -> None:
    data = recording(samples(3.0), chunk_size_bytes=2000)
    path = tmp_path / "recording.mcap"
    path.write_bytes(data)
    disk = FailingDisk(3, 4, 8)
    with DamagedFile(path, disk) as file:
        found = first_pass(file, lambda _: None)
    lost = [
        start
        for start, end in content(data)
        # The head of a chunk can be restored.
        if any(
            start + HEAD.size < (page + 1) * PAGE_BYTES and page * PAGE_BYTES < end
            for page in disk.bad_pages
        )
    ]
    assert 3 < len(lost) < len(content(data))
    assert [chunk.offset for chunk in found.lost_chunks] == lost
    assert all(found.holds(start) for start, _ in content(data) if start not in lost)
    assert found.complete


def test_what_cannot_be_opened_is_told(tmp_path: Path) -> None:
    with pytest.raises(StreamError, match="Is a directory"):
        DamagedFile(tmp_path)
