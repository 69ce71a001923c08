"""The summary at the end of a recording, and whether a checksum vouches for it."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field

from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Schema, Statistics

from acquisition.recovery.damaged_file import DamagedFile
from acquisition.recovery.record_checks import SoundRecord, read_record
from acquisition.stream.checksum import crc32
from acquisition.stream.framing import HEAD, MAGIC

_FOOTER = struct.Struct("<QQI")  # start of the summary, of its offsets, and the checksum
_CRC_BYTES = 4  # the checksum cannot vouch for itself
_COLUMNS = 4


@dataclass(frozen=True, slots=True)
class ListedChunk:
    """A chunk by the index: where it is, and the log times of its messages."""

    offset: int
    length_bytes: int
    start_ns: int
    end_ns: int


@dataclass(slots=True)
class SummarySection:
    """What the summary says.

    Attributes:
        intact: its checksum is right. Otherwise what it says may be wrong, and serves only as a
            hint where to look.
        definitions: schemas and channels, repeated.
        expected: messages of each channel number; None where it does not say.
    """

    intact: bool = False
    definitions: list[Schema | Channel] = field(default_factory=list)
    expected: dict[int, int] | None = None
    # Numbers side by side: a long recording lists a million chunks.
    _chunks: array[int] = field(default_factory=lambda: array("Q"))

    def chunks(self) -> Iterator[ListedChunk]:
        """Give the chunks in the order of the index."""
        for row in range(0, len(self._chunks), _COLUMNS):
            yield ListedChunk(*self._chunks[row : row + _COLUMNS])

    def offsets(self) -> list[int]:
        """Return where the chunks start, in file order."""
        return sorted(self._chunks[::_COLUMNS])

    def take(self, record: SoundRecord) -> None:
        """Note what a record of the summary section says."""
        match record.content:
            case Schema() | Channel():
                self.definitions.append(record.content)
            case Statistics(channel_message_counts=counts):
                self.expected = dict(counts)
            case ChunkIndex() as listed:
                times_ns = (listed.message_start_time, listed.message_end_time)
                self._chunks.extend((listed.chunk_start_offset, listed.chunk_length, *times_ns))


def read_summary(file: DamagedFile) -> SummarySection:
    """Return the summary as far as it is readable; empty when there is none."""
    summary = SummarySection()
    footer_offset = file.size_bytes - len(MAGIC) - _FOOTER.size - HEAD.size
    with suppress(ValueError):  # what was read until then may still help
        footer = file.read(footer_offset, HEAD.size + _FOOTER.size)
        start, _, expected = _FOOTER.unpack(footer[HEAD.size :])
        if footer[: HEAD.size] != HEAD.pack(Opcode.FOOTER, _FOOTER.size) or start == 0:
            return summary
        crc = 0
        for record in _records(file, start, footer_offset):
            summary.take(record)
            crc = crc32(record.body, crc32(record.head.packed, crc))
        # 0 says that the writer computed no checksum.
        summary.intact = bool(expected) and expected == crc32(footer[:-_CRC_BYTES], crc)
    return summary


def _records(file: DamagedFile, offset: int, end: int) -> Iterator[SoundRecord]:
    while offset < end:
        record = read_record(file, offset)
        yield record
        offset = record.head.end
