"""First pass over a damaged recording: what in it is sound, and what its numbers mean."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

from mcap.opcode import Opcode

from acquisition.recovery.damaged_file import DamagedFile
from acquisition.recovery.definitions import Definitions
from acquisition.recovery.followers import known_record_follows, record_follows
from acquisition.recovery.record_checks import (
    SoundRecord,
    chunk_times_ns,
    read_record,
)
from acquisition.recovery.resync import next_record
from acquisition.recovery.summary_section import ListedChunk, read_summary
from acquisition.stream.checksum import crc32
from acquisition.stream.framing import FIRST_PRIVATE_OPCODE, MAGIC
from acquisition.stream.read_report import Damage


@dataclass(slots=True)
class Span:
    """Sound records that follow one another without a gap.

    Attributes:
        start: offset of the first of them.
        end: offset behind the last.
        anchored: it begins at the file's start or at a record with a checksum. Otherwise it was
            found behind damage, and its messages may be what a damaged chunk held.
    """

    start: int
    end: int
    anchored: bool


@dataclass(slots=True)
class Salvage:
    """What the first pass found.

    Attributes:
        spans: where the sound records are, in file order.
        damaged: what lies between them.
        lost_chunks: chunks that are not among the sound records: by the recording's index where
            that is intact, otherwise as far as the damaged records still say.
        definitions: every schema and channel that was found.
        profile: what the recording's header says it is; None where there is no header.
        chunked: there are chunks, or traces of them.
        checksummed: at least one chunk has a checksum.
        vouched: a checksum over all of the data is right.
        doubted: that checksum is wrong although no damage was found: it must lie in what has no
            checksum of its own.
        restored: chunks whose head was damaged and whose content was not.
        expected: messages of each channel number by the intact summary; None without one.
        complete: footer and closing magic are there.
    """

    spans: list[Span] = field(default_factory=list)
    damaged: list[Damage] = field(default_factory=list)
    lost_chunks: list[Damage] = field(default_factory=list)
    definitions: Definitions = field(default_factory=Definitions)
    profile: str | None = None
    chunked: bool = False
    checksummed: bool = False
    vouched: bool = False
    doubted: bool = False
    restored: int = 0
    expected: dict[int, int] | None = None
    complete: bool = False

    def leave_out(self, offset: int, end: int, reason: str) -> None:
        """Note that the bytes between two offsets are not copied."""
        last = self.damaged[-1] if self.damaged else None
        if last and last.reason == reason and last.offset + last.length_bytes == offset:
            self.damaged[-1] = replace(last, length_bytes=end - last.offset)
        else:
            self.damaged.append(Damage(offset, end - offset, reason))

    def guessed_profile(self) -> str:
        """Return the profile; without a header, what the encodings speak for."""
        if self.profile is not None:
            return self.profile
        encodings = {channel.message_encoding for channel in self.definitions.channels.values()}
        return "ros2" if encodings == {"cdr"} else ""

    def holds(self, offset: int) -> bool:
        """Tell whether a sound record lies at an offset."""
        number = bisect_right(self.spans, offset, key=lambda span: span.start) - 1
        return number >= 0 and offset < self.spans[number].end


def sound_records(file: DamagedFile, start: int, end: int) -> Iterator[SoundRecord]:
    """Give the records between two offsets, as long as they are sound.

    Raises:
        ValueError: one is not; the reason.
    """
    while start < end:
        record = read_record(file, start)
        start = record.head.end
        if record.head.opcode == Opcode.MESSAGE and not record_follows(file, start):
            # Nothing but the next record speaks for the length of a message.
            raise ValueError("no record follows this message; its length cannot be believed")
        if record.head.opcode >= FIRST_PRIVATE_OPCODE and not known_record_follows(file, start):
            # It would swallow whatever lies within its length.
            raise ValueError("no known record, and none follows; its length cannot be believed")
        yield record


def first_pass(file: DamagedFile, progress: Callable[[int], None]) -> Salvage:
    """Read the whole file, without keeping any content.

    Args:
        file: the file.
        progress: called with the number of bytes behind, now and then.
    """
    return _FirstPass(file, progress).run()


class _FirstPass:
    def __init__(self, file: DamagedFile, progress: Callable[[int], None]) -> None:
        self._file = file
        self._progress = progress
        self._found = Salvage()
        # Of everything since the start; None behind damage.
        self._crc: int | None = None

    def run(self) -> Salvage:
        """Go through the file once and return what was found."""
        found, file = self._found, self._file
        summary = read_summary(file)
        if summary.intact:
            found.definitions.add(summary.definitions, proven=True)
            found.expected = summary.expected
        listed_offsets = summary.offsets()
        offset = self._start()
        anchored = True
        while offset < file.size_bytes and not found.complete:
            offset, reason = self._span(offset, anchored)
            if reason:
                self._crc = None
                following = next_record(file, offset, listed_offsets)
                self._damage(offset, following, reason)
                offset, anchored = following, False
        if offset < file.size_bytes:
            self._damage(offset, file.size_bytes, "it lies behind the end of the recording")
        found.spans = [span for span in found.spans if span.start < span.end]
        if summary.intact and listed_offsets:
            found.lost_chunks = [_lost(c) for c in summary.chunks() if not found.holds(c.offset)]
        return found

    def _start(self) -> int:
        """Return where the first record is expected."""
        size = min(len(MAGIC), self._file.size_bytes)
        if self._file.peek(0)[:size] == MAGIC:
            self._crc = crc32(MAGIC)
        else:
            self._damage(0, size, "this is not how a recording starts")
        return size

    def _damage(self, offset: int, end: int, reason: str) -> None:
        times_ns = chunk_times_ns(self._file, offset)
        damage = Damage(offset, end - offset, reason, *(times_ns or (None, None)))
        self._found.damaged.append(damage)
        if times_ns is not None:
            self._found.chunked = True
            self._found.lost_chunks.append(damage)

    def _span(self, offset: int, anchored: bool) -> tuple[int, str]:
        """Take sound records; return where they end and why, "" at the end of the recording."""
        span = Span(offset, offset, anchored)
        self._found.spans.append(span)
        try:
            for record in sound_records(self._file, offset, self._file.size_bytes):
                if record.proven and not span.anchored:
                    span = Span(record.head.offset, record.head.offset, True)
                    self._found.spans.append(span)
                span.end = record.head.end
                self._take(record)
                self._progress(span.end)
                if self._found.complete:
                    return span.end + len(MAGIC), ""
        except ValueError as error:
            return span.end, str(error)
        return span.end, ""

    def _take(self, record: SoundRecord) -> None:
        """Note what a record says about the recording."""
        found, content = self._found, record.content
        found.restored += record.restored
        match record.head.opcode:
            case Opcode.HEADER:
                found.profile = content.profile
            case Opcode.CHUNK:
                found.chunked = True
                found.checksummed |= record.proven
                found.definitions.add(record.inside, proven=record.proven)
            case Opcode.MESSAGE_INDEX | Opcode.CHUNK_INDEX:
                found.chunked = True
            case Opcode.SCHEMA | Opcode.CHANNEL:
                found.definitions.add([content], proven=False)
            case Opcode.DATA_END:
                self._check_data(content.data_section_crc)
            case Opcode.FOOTER:
                found.complete = self._file.peek(record.head.end)[: len(MAGIC)] == MAGIC
        if self._crc is not None:
            self._crc = crc32(record.body, crc32(record.head.packed, self._crc))

    def _check_data(self, expected: int) -> None:
        """Compare the checksum of everything before the DataEnd record, if there is one."""
        if expected == 0 or self._crc is None:
            return
        if expected == self._crc:
            self._found.vouched = True
            self._found.definitions.prove()
        else:
            self._found.doubted = True


def _lost(chunk: ListedChunk) -> Damage:
    reason = "listed in the index of the recording, but not sound"
    return Damage(chunk.offset, chunk.length_bytes, reason, chunk.start_ns, chunk.end_ns)
