"""A sound recording with an index, to copy parts of it; damage is an error here."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import zstandard
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Message, Metadata, Schema, Statistics
from mcap.summary import Summary

from acquisition.closing import ClosedOnExit
from acquisition.errors import StreamError
from acquisition.recovery.damaged_file import DamagedFile
from acquisition.recovery.record_checks import read_record
from acquisition.recovery.summary_section import summary_is_contradicted
from acquisition.stream.framing import MAGIC

# What mcap, zstandard (ZstdError) and lz4 (RuntimeError) raise on a damaged file.
_DAMAGE = (
    McapError,
    zstandard.ZstdError,
    struct.error,
    ValueError,
    KeyError,
    OverflowError,
    EOFError,
    RuntimeError,
    MemoryError,  # a damaged length
    OSError,
)

_R = TypeVar("_R")


@dataclass(frozen=True, slots=True)
class Defined:
    """A message, and what defines it."""

    channel: Channel
    schema: Schema | None
    message: Message


class IntactRecording(ClosedOnExit):
    """Reads by the index, in order of log time; one iteration at a time.

    Attributes:
        path: the file.
        profile: what its header says it is.
        statistics: what its summary says about it.
    """

    def __init__(self, path: Path) -> None:
        """Open the file and read its index.

        Raises:
            StreamError: it cannot be read, or it is no complete recording with an index.
        """
        self.path = path
        # mcap's reader does not check attachments and metadata.
        self._checked = DamagedFile(path)
        self._file = path.open("rb")
        try:
            with self._damage_told():
                self._check_ends()
                self._reader = make_reader(self._file, validate_crcs=True)
                summary = self._reader.get_summary()
                self.profile = self._reader.get_header().profile
            self._summary, self.statistics = self._indexed(summary)
        except BaseException:
            self.close()
            raise

    def _check_ends(self) -> None:
        """Look at what mcap's reader takes on trust, and what its errors do not name.

        Raises:
            StreamError: there is too little to call it damaged.
            ValueError: it has no end, or the summary, which names every topic and type, is not
                what its checksum says.
        """
        size_bytes = self._checked.size_bytes
        if size_bytes < len(MAGIC):
            found = f"only {size_bytes} bytes" if size_bytes else "nothing"
            raise StreamError(f"{self.path} holds {found}; expected an MCAP recording")
        if summary_is_contradicted(self._checked):
            raise ValueError("checksum of the summary differs")

    @contextmanager
    def _damage_told(self) -> Iterator[None]:
        try:
            yield
        except _DAMAGE as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise StreamError(
                f"{self.path} is damaged or has no proper end ({reason}); recover it first"
            ) from error

    def _indexed(self, summary: Summary | None) -> tuple[Summary, Statistics]:
        """Refuse what could only be read by holding all of it in memory."""
        statistics = summary.statistics if summary else None
        if summary is None or statistics is None:
            raise StreamError(f"{self.path} has no index; recover it first")
        if len(summary.chunk_indexes) != statistics.chunk_count or (
            statistics.message_count and not summary.chunk_indexes
        ):
            raise StreamError(f"{self.path} has an incomplete index; recover it first")
        return summary, statistics

    def channels(self) -> list[tuple[Channel, Schema | None]]:
        """Return every channel and its schema, in the order of their numbers."""
        found = sorted(self._summary.channels.items())
        return [(channel, self._summary.schemas.get(channel.schema_id)) for _, channel in found]

    def messages(
        self,
        *,
        start_ns: int | None = None,
        end_ns: int | None = None,
        topics: Collection[str] | None = None,
    ) -> Iterator[Defined]:
        """Give the messages in order of log time, and of the file where that is the same.

        Args:
            start_ns: the first log time that counts.
            end_ns: the first that does not count any more.
            topics: those that count; all by default.

        Raises:
            StreamError: a chunk is damaged.
        """
        with self._damage_told():
            for schema, channel, message in self._reader.iter_messages(
                topics, starting_at=start_ns, ending_before=end_ns
            ):
                yield Defined(channel, schema, message)

    def metadata(self) -> Iterator[Metadata]:
        """Give the metadata records.

        Raises:
            StreamError: one is damaged.
        """
        yield from self._records((i.offset for i in self._summary.metadata_indexes), Metadata)

    def attachments(self) -> Iterator[Attachment]:
        """Give the attachments.

        Raises:
            StreamError: one is damaged.
        """
        yield from self._records((i.offset for i in self._summary.attachment_indexes), Attachment)

    def _records(self, offsets: Iterable[int], kind: type[_R]) -> Iterator[_R]:
        with self._damage_told():
            for offset in offsets:
                record = read_record(self._checked, offset).content
                if not isinstance(record, kind):
                    raise StreamError(
                        f"{self.path} is damaged (no {kind.__name__.lower()} record at offset "
                        f"{offset}); recover it first"
                    )
                yield record

    def close(self) -> None:
        """Close the file; harmless when closed."""
        self._file.close()
        self._checked.close()
