"""A ring's snapshots on their way to disk, in a thread of their own.

A disk may take longer for a snapshot than the queues last. One snapshot is written at a time, so
that beside the ring no more than what it held is in memory, however often somebody asks.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from acquisition.errors import StreamError
from acquisition.files import replacing
from acquisition.recording.folder_store import MB
from acquisition.stream.parts import part_path


class SnapshotWriter:
    """Writes NAME_snap000.mcap, ...; the numbers go on behind those that are there."""

    def __init__(self, path: Path, reserve_bytes: int, free: Callable[[Path], int]) -> None:
        """Touch nothing yet.

        Args:
            path: what the snapshots are named after.
            reserve_bytes: a snapshot that would leave less on the disk is not written.
            free: tells how much room a folder has.
        """
        self._path = path
        self._reserve_bytes = reserve_bytes
        self._free = free
        self._number = 0
        # Number of each snapshot and how many parts of it were written: paths would take more.
        self._written: list[tuple[int, int]] = []
        self._failures = 0
        self._failure = ""
        self._writing: Future[None] | None = None
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="snapshot")

    def start(self) -> None:
        """Find the first number: a snapshot whose name is taken would be lost."""
        self._number = _number_behind_all(self._path)

    def is_busy(self) -> bool:
        """Tell whether a snapshot is being written."""
        if self._writing is None or not self._writing.done():
            return self._writing is not None
        self.wait()
        return False

    def wait(self) -> None:
        """Wait for the snapshot that is being written."""
        if self._writing is None:
            return
        error = self._writing.exception()
        self._writing = None  # and with its error what it was to write
        if error is not None:
            self._failures += 1
            self._failure = str(error)

    def submit(self, parts: Sequence[bytes]) -> None:
        """Have these parts written as the next snapshot; not while it is busy."""
        self._writing = self._thread.submit(self._write, self._number, parts)
        self._number += 1

    def problem(self) -> str:
        """Return why the latest of the snapshots that failed was not written, or ""."""
        if self._failures < 2:
            return self._failure
        return f"{self._failures} snapshots not written, the last because: {self._failure}"

    def close(self) -> None:
        """Wait, and end the thread."""
        self.wait()
        self._thread.shutdown()

    def files(self) -> tuple[Path, ...]:
        """Return what was written, in order."""
        return tuple(
            [
                part_path(self._snapshot(number), index)
                for number, count in self._written
                for index in range(count)
            ]
        )

    def _snapshot(self, number: int) -> Path:
        return self._path.with_stem(f"{self._path.stem}_snap{number:03d}")

    def _write(self, number: int, parts: Sequence[bytes]) -> None:
        path = self._snapshot(number)
        size_bytes = sum(map(len, parts))
        free = self._free(path.parent)
        if free - size_bytes < self._reserve_bytes:
            raise StreamError(
                f"snapshot {path} of {size_bytes // MB} MB not written: {free // MB} MB are "
                f"free, the reserve is {self._reserve_bytes // MB} MB"
            )
        self._written.append((number, 0))
        for index, data in enumerate(parts):
            _write_file(part_path(path, index), data)
            self._written[-1] = number, index + 1


def _number_behind_all(path: Path) -> int:
    """Return the number of the next snapshot: behind those of older recordings of that name."""
    pattern = re.compile(rf"{re.escape(path.stem)}_snap(\d+)(?:_\d+)?{re.escape(path.suffix)}")
    matches = (pattern.fullmatch(file.name) for file in path.parent.glob(f"*{path.suffix}"))
    return max((int(match[1]) + 1 for match in matches if match), default=0)


def _write_file(path: Path, data: bytes) -> None:
    if path.exists():
        raise StreamError(f"{path} exists already; give the recording another name")
    try:
        with replacing(path) as temporary:
            temporary.write_bytes(data)
    except OSError as error:
        raise StreamError(f"cannot write {path}: {error.strerror}") from error
