"""What speaks for a record of a damaged file: a checksum of its own, or at least its form.

Format: https://mcap.dev/spec. Chunks and attachments carry a checksum; nothing else does.
"""

from __future__ import annotations

import struct
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Protocol

import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode

from acquisition.recovery.attachment_checks import exact_attachment, has_checksum
from acquisition.recovery.damaged_file import DamagedFile
from acquisition.stream.chunks import Content, open_chunk, parse, parse_chunk, parse_message
from acquisition.stream.framing import (
    FIRST_PRIVATE_OPCODE,
    HEAD,
    KNOWN_OPCODES,
    MAX_RECORD_BYTES,
)

_BEFORE_COMPRESSION_BYTES = 28  # two times, the size and the checksum of a chunk
_TIMES = struct.Struct("<QQ")
_U32 = struct.Struct("<I")
_U64 = struct.Struct("<Q")
_INDEX_HEAD_BYTES = 6
_INDEX_ENTRY_BYTES = 16
_MESSAGE_HEAD_BYTES = 22
_CRC_BYTES = 4


class _Kind(Protocol):
    """One of mcap's record classes."""

    def read(self, stream: ReadDataStream, /) -> records.McapRecord:
        """Return the record that starts there."""


# The records that are rewritten to see whether they are exactly what they say.
_BY_OPCODE: dict[int, _Kind] = {
    Opcode.HEADER: records.Header,
    Opcode.FOOTER: records.Footer,
    Opcode.SCHEMA: records.Schema,
    Opcode.CHANNEL: records.Channel,
    Opcode.CHUNK_INDEX: records.ChunkIndex,
    Opcode.ATTACHMENT_INDEX: records.AttachmentIndex,
    Opcode.STATISTICS: records.Statistics,
    Opcode.METADATA: records.Metadata,
    Opcode.METADATA_INDEX: records.MetadataIndex,
    Opcode.SUMMARY_OFFSET: records.SummaryOffset,
    Opcode.DATA_END: records.DataEnd,
}


@dataclass(frozen=True, slots=True)
class Head:
    """The first nine bytes of a record.

    Attributes:
        offset: where it starts in the file.
        opcode: what it says it is.
        length: length of its body, bytes.
    """

    offset: int
    opcode: int
    length: int

    @property
    def end(self) -> int:
        """Offset behind the record, if it can be believed."""
        return self.offset + HEAD.size + self.length

    @property
    def packed(self) -> bytes:
        """The nine bytes."""
        return HEAD.pack(self.opcode, self.length)


@dataclass(frozen=True, slots=True)
class SoundRecord:
    """A record in which nothing wrong was found.

    Attributes:
        head: where and how long it is.
        body: its bytes.
        proven: a checksum of its own vouches for it.
        content: the record as mcap reads it; None for the kinds that nobody needs.
        inside: what a chunk holds, in order.
        restored: its head was damaged and is told by its content.
    """

    head: Head
    body: bytes
    proven: bool
    content: Any = None
    inside: tuple[Content, ...] = ()
    restored: bool = False


def read_head(file: DamagedFile, offset: int) -> Head:
    """Return the head of the record that starts at an offset.

    Raises:
        ValueError: no record can start there.
    """
    opcode, length = HEAD.unpack(file.read(offset, HEAD.size))
    if opcode not in KNOWN_OPCODES and opcode < FIRST_PRIVATE_OPCODE:
        raise ValueError(f"no record starts here (opcode 0x{opcode:02x})")
    if length > MAX_RECORD_BYTES:
        raise ValueError(f"record of {length} bytes; at most {MAX_RECORD_BYTES} are accepted")
    if opcode == Opcode.MESSAGE and length < _MESSAGE_HEAD_BYTES:
        raise ValueError(f"message record of {length} bytes")
    return Head(offset, opcode, length)


def read_record(file: DamagedFile, offset: int) -> SoundRecord:
    """Return the record that starts at an offset.

    A chunk is recognised by its content alone when the nine bytes before it are damaged: it
    holds its length once more, and its checksum.

    Raises:
        ValueError: there is none, or it is damaged; the reason.
    """
    try:
        return read_sound(file, read_head(file, offset))
    except ValueError:
        record = _headless_chunk(file, offset)
        if record is None:
            raise
        return record


def _headless_chunk(file: DamagedFile, offset: int) -> SoundRecord | None:
    length = _chunk_length(file, offset)
    if length is None:
        return None
    try:
        record = read_sound(file, Head(offset, Opcode.CHUNK, length))
    except ValueError:
        return None
    return replace(record, restored=True) if record.proven else None


def _chunk_length(file: DamagedFile, offset: int) -> int | None:
    """Return how long the body of a chunk is by the lengths inside it; None for nonsense."""
    try:
        name_bytes = _u32(file, offset + HEAD.size + _BEFORE_COMPRESSION_BYTES)
        before_data = _BEFORE_COMPRESSION_BYTES + 4 + name_bytes + 8
        length = before_data + _u64(file, offset + HEAD.size + before_data - 8)
    except ValueError:
        return None
    return length if length <= MAX_RECORD_BYTES else None


def read_sound(file: DamagedFile, head: Head) -> SoundRecord:
    """Return the record of a head.

    Raises:
        ValueError: it is cut off, its checksum differs, or it is not of the form it must have.
    """
    body = file.read(head.offset + HEAD.size, head.length)
    if head.opcode == Opcode.CHUNK:
        chunk, inside = _open_chunk(body)
        return SoundRecord(head, body, chunk.uncompressed_crc != 0, chunk, inside)
    if head.opcode == Opcode.ATTACHMENT:
        return SoundRecord(head, body, has_checksum(body), exact_attachment(body))
    if head.opcode == Opcode.MESSAGE:
        return SoundRecord(head, body, False, parse_message(body))
    if head.opcode == Opcode.MESSAGE_INDEX:
        _check_message_index(body)
    kind = _BY_OPCODE.get(head.opcode)
    return SoundRecord(head, body, False, _exact(kind, head.opcode, body) if kind else None)


def _open_chunk(body: bytes) -> tuple[records.Chunk, tuple[Content, ...]]:
    """Return a chunk and what it holds; a zstd frame knows its size when the chunk does not."""
    chunk = parse_chunk(body)
    if chunk.compression == "zstd" and chunk.uncompressed_crc:
        with suppress(zstandard.ZstdError):  # `open_chunk` says what is wrong with it
            size = zstandard.frame_content_size(chunk.data)
            chunk.uncompressed_size = size if size > 0 else chunk.uncompressed_size
    return chunk, tuple(open_chunk(chunk))


def _exact(kind: _Kind, opcode: int, body: bytes) -> records.McapRecord:
    """Return the record that gives the same bytes when it is written again."""
    record = parse(kind.read, body)
    builder = RecordBuilder()
    try:
        record.write(builder)
        written = builder.end()[HEAD.size :]
    except struct.error as error:
        raise ValueError(f"not a readable record ({error})") from error
    if written != body:
        raise ValueError(f"{Opcode(opcode).name.lower()} record of another form than it must have")
    return record


def _check_message_index(body: bytes) -> None:
    # Not rewritten: there are as many entries as messages, and nobody needs them.
    entries = len(body) - _INDEX_HEAD_BYTES
    if entries < 0 or entries % _INDEX_ENTRY_BYTES or _U32.unpack_from(body, 2)[0] != entries:
        raise ValueError("message index record of another form than it must have")


def may_be_another_kind(body: bytes, *, chunked: bool = True) -> bool:
    """Tell whether the body of a message record has the form of a kind that one bit makes of it.

    Args:
        body: of the record.
        chunked: the recording has chunks. Without any there is no index of their messages, and
            one in thousands of good messages looks like one.
    """
    for opcode in (bit ^ Opcode.MESSAGE for bit in (1, 2, 4, 8)):
        try:
            if opcode == Opcode.MESSAGE_INDEX and not chunked:
                continue
            if opcode == Opcode.MESSAGE_INDEX:
                _check_message_index(body)
            else:
                _exact(_BY_OPCODE[opcode], opcode, body)
        except ValueError:
            continue
        return True
    return False


def lengths_agree(file: DamagedFile, head: Head) -> bool:
    """Tell, without reading the data, whether the lengths inside a record fit the one outside.

    Looks into chunks and attachments, the two that may be long; true for all others.
    """
    start = head.offset + HEAD.size
    try:
        if head.opcode == Opcode.CHUNK:
            return _chunk_length(file, head.offset) == head.length
        if head.opcode == Opcode.ATTACHMENT:
            type_at = start + _TIMES.size + 4 + _u32(file, start + _TIMES.size)
            data_at = type_at + 4 + _u32(file, type_at)
            return data_at + 8 + _u64(file, data_at) + _CRC_BYTES == head.end
    except ValueError:
        return False
    return True


def _u32(file: DamagedFile, offset: int) -> int:
    (value,) = _U32.unpack(file.read(offset, _U32.size))
    return int(value)


def _u64(file: DamagedFile, offset: int) -> int:
    (value,) = _U64.unpack(file.read(offset, _U64.size))
    return int(value)


def chunk_times_ns(file: DamagedFile, offset: int) -> tuple[int, int] | None:
    """Return the time range that a damaged chunk announces, if the rest of its head makes sense."""
    try:
        head = read_head(file, offset)
        if head.opcode != Opcode.CHUNK or not lengths_agree(file, head):
            return None
        start_ns, end_ns = _TIMES.unpack(file.read(offset + HEAD.size, _TIMES.size))
    except ValueError:
        return None
    return (start_ns, end_ns) if start_ns <= end_ns else None
