"""The chunk in progress: the messages of one MCAP chunk, and the records that they become."""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Schema

from acquisition.messages.cdr_layout import Parts
from acquisition.stream.checksum import crc32

_COMPRESSION = "zstd"
_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_MESSAGE_OPCODE = int(Opcode.MESSAGE)  # to look up a member of an Enum costs as much as to pack
_MESSAGE_BYTES = _MESSAGE.size
_MESSAGE_FIELDS_BYTES = struct.calcsize("<HIQQ")
# Opcode, length, first and last time, size, checksum, compression, size of what follows.
_CHUNK = struct.Struct(f"<BQQQQII{len(_COMPRESSION)}sQ")
_CHUNK_FIELDS_BYTES = _CHUNK.size - struct.calcsize("<BQ")
_INDEX = struct.Struct("<BQHI")  # opcode, length, channel, bytes of the entries
_INDEX_FIELDS_BYTES = struct.calcsize("<HI")


@dataclass(frozen=True, slots=True)
class FinishedChunk:
    """A chunk that will not change any more.

    Attributes:
        record: the Chunk record.
        index_record: the MessageIndex records that follow it.
        counts: number of messages by channel, in order of their first message.
        first_ns: the earliest log time.
        last_ns: the latest log time.
        summary: what the summary section says of the chunk.
    """

    record: bytes
    index_record: bytes
    counts: dict[int, int]
    first_ns: int
    last_ns: int
    summary: ChunkIndex


class ChunkBuilder:
    """Takes messages in pieces and copies none of them before the chunk is finished.

    Attributes:
        size_bytes: size before compression so far.
    """

    def __init__(self) -> None:
        self._compressor = zstandard.ZstdCompressor()
        self._clear()

    def _clear(self) -> None:
        self._parts: list[bytes | memoryview] = []
        # For each channel log time and offset of each message, one behind the other.
        self._entries: defaultdict[int, list[int]] = defaultdict(list)
        self.size_bytes = 0

    def define(self, definition: Schema | Channel) -> None:
        """Put a definition where the chunk stands."""
        builder = RecordBuilder()
        definition.write(builder)
        record = builder.end()
        self._parts.append(record)
        self.size_bytes += len(record)

    def add(
        self,
        channel_ids: Sequence[int],
        messages: Sequence[Parts | None],
        log_time_ns: int,
        publish_time_ns: int,
        sequence: int,
    ) -> int:
        """Take what one sample is written as; return the size of its data.

        The data may not change before `finish`. A message that is None is left out.
        """
        parts, offset, data_bytes = self._parts, self.size_bytes, 0
        for channel_id, message in zip(channel_ids, messages, strict=True):
            if message is None:
                continue
            size_bytes = len(message[0]) if len(message) == 1 else sum(map(len, message))
            head = _MESSAGE.pack(
                _MESSAGE_OPCODE,
                _MESSAGE_FIELDS_BYTES + size_bytes,
                channel_id,
                sequence,
                log_time_ns,
                publish_time_ns,
            )
            parts.append(head)
            parts += message
            self._entries[channel_id] += (log_time_ns, offset)
            offset += _MESSAGE_BYTES + size_bytes
            data_bytes += size_bytes
        self.size_bytes = offset
        return data_bytes

    def finish(self, offset: int) -> FinishedChunk | None:
        """Return the chunk and begin the next; None, and nothing begun, without any message.

        Args:
            offset: where in the file the chunk will lie.
        """
        if not self._entries:
            return None
        data, entries = b"".join(self._parts), self._entries
        self._clear()
        first_ns = min(min(times[::2]) for times in entries.values())
        last_ns = max(max(times[::2]) for times in entries.values())
        crc = crc32(data)  # while what was just joined is in the processor's cache
        compressed = self._compressor.compress(data)
        length = _CHUNK_FIELDS_BYTES + len(compressed)
        head = _CHUNK.pack(
            Opcode.CHUNK,
            length,
            first_ns,
            last_ns,
            len(data),
            crc,
            len(_COMPRESSION),
            _COMPRESSION.encode(),
            len(compressed),
        )
        record = head + compressed
        index_record, offsets = _index(entries, offset + len(record))
        return FinishedChunk(
            record,
            index_record,
            {channel_id: len(times) // 2 for channel_id, times in entries.items()},
            first_ns,
            last_ns,
            ChunkIndex(
                chunk_length=len(record),
                chunk_start_offset=offset,
                compression=_COMPRESSION,
                compressed_size=len(compressed),
                message_end_time=last_ns,
                message_index_length=len(index_record),
                message_index_offsets=offsets,
                message_start_time=first_ns,
                uncompressed_size=len(data),
            ),
        )


def _index(entries: dict[int, list[int]], offset: int) -> tuple[bytes, dict[int, int]]:
    """Return the MessageIndex records of all channels, and where in the file each will lie."""
    index = bytearray()
    offsets: dict[int, int] = {}
    for channel_id, numbers in entries.items():
        offsets[channel_id] = offset + len(index)
        size_bytes = 8 * len(numbers)
        length = _INDEX_FIELDS_BYTES + size_bytes
        index += _INDEX.pack(Opcode.MESSAGE_INDEX, length, channel_id, size_bytes)
        index += struct.pack(f"<{len(numbers)}Q", *numbers)
    return bytes(index), offsets
