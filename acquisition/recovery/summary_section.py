"""The summary at the end of a recording, and whether a checksum vouches for it."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import NamedTuple

from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Schema, Statistics

from acquisition.recovery.damaged_file import WINDOW_BYTES, DamagedFile
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
    with suppress(ValueError):  # what was read until then may still help
        ending = _ending(file)
        if ending.start == 0:
            return summary
        for record in _records(file, ending.start, ending.footer_offset):
            summary.take(record)
        # 0 says that the writer computed no checksum.
        summary.intact = bool(ending.crc) and ending.crc == _crc(file, ending)
    return summary


def summary_is_contradicted(file: DamagedFile) -> bool:
    """Tell whether there is a checksum of the summary, and it is wrong.

    Raises:
        ValueError: the file has no end that would say so.
    """
    ending = _ending(file)
    return bool(ending.start and ending.crc) and ending.crc != _crc(file, ending)


class _Ending(NamedTuple):
    footer_offset: int
    start: int  # of the summary; 0 where there is none
    crc: int


def _ending(file: DamagedFile) -> _Ending:
    offset = file.size_bytes - len(MAGIC) - _FOOTER.size - HEAD.size
    if offset < 0:
        raise ValueError("too short to have an end")
    footer = file.read(offset, HEAD.size + _FOOTER.size)
    if footer[: HEAD.size] != HEAD.pack(Opcode.FOOTER, _FOOTER.size):
        raise ValueError("no footer at its end")
    start, _, crc = _FOOTER.unpack(footer[HEAD.size :])
    return _Ending(offset, start, crc)


def _crc(file: DamagedFile, ending: _Ending) -> int:
    """Return the checksum of everything from the summary's start to that of the footer's crc."""
    end = ending.footer_offset + HEAD.size + _FOOTER.size - _CRC_BYTES
    crc = 0
    for offset in range(ending.start, end, WINDOW_BYTES):
        crc = crc32(file.read(offset, min(WINDOW_BYTES, end - offset)), crc)
    return crc


def _records(file: DamagedFile, offset: int, end: int) -> Iterator[SoundRecord]:
    while offset < end:
        record = read_record(file, offset)
        yield record
        offset = record.head.end
