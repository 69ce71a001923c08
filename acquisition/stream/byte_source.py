"""Where a stream's bytes come from: a finished file, a growing file, a pipe."""

from __future__ import annotations

import io
import math
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol, cast

from acquisition.closing import ClosedOnExit
from acquisition.errors import StreamError

POLL_INTERVAL_S = 0.02
_SKIP_BYTES = 1 << 20


class ByteSource(Protocol):
    """What a reader needs: the next bytes, in order, once."""

    @property
    def name(self) -> str:
        """What to call it in an error."""

    def read(self, max_bytes: int) -> bytes:
        """Return 1 to `max_bytes` further bytes, waiting for them if need be.

        Empty means that no more will come.

        Raises:
            StreamError: the system refused.
        """

    def skip_rest(self) -> int:
        """Give up reading and return how many bytes would have followed, as far as is known."""


class Pipe:
    """Standard input, or any other open stream; closing it is left to its owner."""

    def __init__(self, stream: io.BufferedIOBase, name: str = "standard input") -> None:
        self.name = name
        self._stream = stream

    def read(self, max_bytes: int) -> bytes:
        """Return what is there, waiting for the first byte only; see `ByteSource`."""
        try:
            return self._stream.read1(max_bytes)
        except OSError as error:
            raise StreamError(f"cannot read {self.name}: {error.strerror}") from error

    def skip_rest(self) -> int:
        """Read to the end, so that the program at the other end does not fail."""
        skipped = 0
        while data := self.read(_SKIP_BYTES):
            skipped += len(data)
        return skipped


def standard_input() -> Pipe:
    """Return standard input as a byte source.

    Raises:
        StreamError: it is a terminal, or there is none.
    """
    if sys.stdin is None or sys.stdin.isatty():
        raise StreamError("standard input is a terminal; expected a recording from a pipe")
    return Pipe(cast(io.BufferedReader, sys.stdin.buffer))


class FinishedFile(ClosedOnExit):
    """A file that nobody is writing any more."""

    def __init__(self, path: Path) -> None:
        """Open the file.

        Raises:
            StreamError: missing, a folder, or not readable.
        """
        self.name = str(path)
        try:
            # Opening a folder for reading fails with EISDIR.
            self._file = path.open("rb", buffering=0)
        except OSError as error:
            hint = "; give an MCAP file; `terravibe import` makes one of depth images"
            hint = hint if isinstance(error, IsADirectoryError) else ""
            raise StreamError(f"cannot read {path}: {error.strerror}{hint}") from error

    def read(self, max_bytes: int) -> bytes:
        """Return what is there now; see `ByteSource`."""
        try:
            return self._file.read(max_bytes)
        except OSError as error:
            raise StreamError(f"cannot read {self.name}: {error.strerror}") from error

    def skip_rest(self) -> int:
        """Return how many bytes the file has now behind those that were read."""
        return os.fstat(self._file.fileno()).st_size - self._file.tell()

    def close(self) -> None:
        """Close the file; harmless when closed."""
        self._file.close()


class GrowingFile(FinishedFile):
    """A file that is being recorded: at its end, wait for more.

    The reader stops asking when it has seen the footer. A recorder that died never writes one,
    so there are two further ends: silence and `stop`.
    """

    def __init__(
        self,
        path: Path,
        *,
        idle_timeout_s: float = math.inf,
        stop: Callable[[], bool] = lambda: False,
        sleep: Callable[[float], object] = time.sleep,
        poll_interval_s: float = POLL_INTERVAL_S,
    ) -> None:
        """Open the file, which may still be empty.

        Args:
            path: the file.
            idle_timeout_s: end after so many seconds without a new byte.
            stop: asked before each wait; true ends the stream.
            sleep: waits that many seconds; `threading.Event.wait` makes a stop immediate.
            poll_interval_s: how long to wait between looks, seconds.

        Raises:
            StreamError: missing, a folder, or not readable.
        """
        super().__init__(path)
        self._idle_timeout_s = idle_timeout_s
        self._stop = stop
        self._sleep = sleep
        self._poll_interval_s = poll_interval_s

    def read(self, max_bytes: int) -> bytes:
        """Return new bytes as soon as there are some; see `ByteSource`.

        Raises:
            StreamError: also when the file became shorter, that is, was written anew.
        """
        idle_s = 0.0
        while not (data := super().read(max_bytes)):
            if self.skip_rest() < 0:
                raise StreamError(f"{self.name} became shorter while it was followed; start again")
            if self._stop() or idle_s >= self._idle_timeout_s:
                return b""
            self._sleep(self._poll_interval_s)
            idle_s += self._poll_interval_s
        return data
