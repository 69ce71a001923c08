"""Where a stream's bytes go: whole MCAP records, counted, under one running checksum."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import DataEnd

from acquisition.errors import StreamError
from acquisition.stream.checksum import crc32


class StreamOutput:
    """The write, tell and flush that `mcap.writer.Writer` asks of a file.

    A pipe will do, because positions are counted instead of asked for. Every `write` is expected
    to hold whole records, as the Writer's do; so after a failure the length of all the records
    that arrived whole is known.

    The Writer keeps its data-section checksum to itself and has no call for a record outside its
    chunks. So the checksum is kept here, where all bytes pass, and put into the DataEnd record.
    """

    def __init__(self, output: Path | BinaryIO) -> None:
        """Open the path, truncating a file that exists; a stream handed in stays its owner's.

        Raises:
            StreamError: the path cannot be opened; names path and cause.
        """
        self._owned = isinstance(output, Path)
        self.name = str(output if isinstance(output, Path) else getattr(output, "name", "stream"))
        self.failed = False
        self._length = 0
        self._crc = 0
        try:
            # Unbuffered: the Writer hands over whole records, and a failed write must not be
            # tried again when the file is closed.
            self._raw = output.open("wb", buffering=0) if isinstance(output, Path) else output
        except OSError as error:
            raise StreamError(f"cannot write {self.name}: {error.strerror}") from error

    def write(self, data: bytes) -> int:
        """Write whole records.

        Raises:
            StreamError: the system refused, for example because the disk is full.
        """
        if data[:1] == Opcode.DATA_END.to_bytes():
            builder = RecordBuilder()
            DataEnd(self._crc).write(builder)
            data = builder.end()
        try:
            self._write_all(data)
        except OSError as error:
            self.failed = True
            raise StreamError(
                f"cannot write {self.name} after {self._length} bytes: {error.strerror}"
            ) from error
        self._length += len(data)
        self._crc = crc32(data, self._crc)
        return len(data)

    def _write_all(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest:
            written = self._raw.write(rest)
            if not written:
                raise BlockingIOError(0, "it does not take more bytes without waiting")
            rest = rest[written:]

    def tell(self) -> int:
        """Return the number of bytes written so far."""
        return self._length

    def flush(self) -> None:
        """Hand everything to the operating system, so that another process can read it.

        Raises:
            StreamError: the system refused.
        """
        try:
            self._raw.flush()
        except OSError as error:
            self.failed = True
            raise StreamError(f"cannot write {self.name}: {error.strerror}") from error

    def close(self) -> None:
        """Close a file that was opened here; after a failed write cut off the torn record.

        Raises:
            StreamError: the system refused, as it may where a file is sent away on closing
                (network, FUSE); after a failed write it goes unsaid, as that was reported.
        """
        if not self._owned or self._raw.closed:
            return
        try:
            if self.failed:
                # A device or a pipe cannot be cut; the failure itself was reported by `write`.
                with suppress(OSError):
                    self._raw.truncate(self._length)
        finally:
            self._close_raw()

    def _close_raw(self) -> None:
        try:
            self._raw.close()
        except OSError as error:
            if not self.failed:
                self.failed = True
                raise StreamError(f"cannot close {self.name}: {error.strerror}") from error
