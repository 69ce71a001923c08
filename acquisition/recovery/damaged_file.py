"""Random access to a file that may be damaged, on a disk that may be failing."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from pathlib import Path

from acquisition.closing import ClosedOnExit
from acquisition.errors import StreamError

WINDOW_BYTES = 1 << 17
PAGE_BYTES = 4096  # what a disk gives or refuses at once


class DamagedFile(ClosedOnExit):
    """Reads pieces of a file at any offset; what it cannot read is a ValueError, not the end.

    It reads instead of mapping: a bad sector or a file that becomes shorter would kill a process
    that has mapped it, and both happen to the files that are handed to this class. A page that
    the disk has refused once is not asked for again, because every refusal takes seconds.

    Attributes:
        size_bytes: length of the file when it was opened; what is appended later is not read.
    """

    def __init__(self, path: Path, pread: Callable[[int, int, int], bytes] = os.pread) -> None:
        """Open the file.

        Args:
            path: the file.
            pread: descriptor, number of bytes, offset -> bytes; like `os.pread`.

        Raises:
            StreamError: missing, a folder, a pipe or a device, or not readable.
        """
        self._pread = pread
        self._window = b""
        self._window_start = 0
        self._bad_pages: set[int] = set()
        try:
            mode = path.stat().st_mode
            if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
                # It has no length and no second reading; opening a pipe may wait for ever.
                raise StreamError(f"cannot read {path}: it is no ordinary file; copy it to one")
            self._file = path.open("rb", buffering=0)
        except OSError as error:
            raise StreamError(f"cannot read {path}: {error.strerror}") from error
        self.size_bytes = os.fstat(self._file.fileno()).st_size

    def read(self, offset: int, length: int) -> bytes:
        """Return exactly that many bytes.

        Raises:
            ValueError: they do not lie within the file, or the disk does not give them.
        """
        if offset < 0 or offset + length > self.size_bytes:
            raise ValueError("the file ends before it is complete")
        if length > WINDOW_BYTES:
            found = self._pages(offset, length)
        else:
            if not self._holds(offset, length):
                self._window, self._window_start = self._pages(offset, WINDOW_BYTES), offset
            start = offset - self._window_start
            found = self._window[start : start + length]
        if len(found) < length:
            raise ValueError(f"the disk cannot be read at offset {offset + len(found)}")
        return found

    def peek(self, offset: int) -> bytes:
        """Return what can be read from an offset on, empty where nothing can.

        Less than a page means that the file ends there or that the disk refuses the next one.
        """
        if not self._holds(offset, PAGE_BYTES):
            self._window, self._window_start = self._pages(offset, WINDOW_BYTES), offset
        return self._window[offset - self._window_start :]

    def _holds(self, offset: int, length: int) -> bool:
        start = offset - self._window_start
        return start >= 0 and start + length <= len(self._window)

    def _pages(self, offset: int, length: int) -> bytes:
        """Return the bytes up to the end of the file or to the first page that is refused."""
        end = min(offset + length, self.size_bytes)
        if self._bad_pages.isdisjoint(range(offset // PAGE_BYTES, -(-end // PAGE_BYTES))):
            try:
                return self._read(offset, end)
            except OSError:
                pass  # find the page
        pieces: list[bytes] = []
        while offset < end and offset // PAGE_BYTES not in self._bad_pages:
            page_end = min((offset // PAGE_BYTES + 1) * PAGE_BYTES, end)
            try:
                pieces.append(self._read(offset, page_end))
            except OSError:
                self._bad_pages.add(offset // PAGE_BYTES)
                break
            offset = page_end
        return b"".join(pieces)

    def _read(self, offset: int, end: int) -> bytes:
        pieces: list[bytes] = []
        while offset < end and (piece := self._pread(self._file.fileno(), end - offset, offset)):
            pieces.append(piece)
            offset += len(piece)
        return b"".join(pieces)

    def close(self) -> None:
        """Close the file; harmless when closed."""
        self._file.close()
