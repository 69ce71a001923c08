"""The chunk in progress: the messages of one MCAP chunk, and the records that they become."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, Schema

_COMPRESSION = "zstd"
_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_MESSAGE_FIELDS_BYTES = struct.calcsize("<HIQQ")
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
        self._entries: dict[int, list[int]] = {}
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
        channel_id: int,
        log_time_ns: int,
        publish_time_ns: int,
        sequence: int,
        parts: Iterable[bytes | memoryview],
    ) -> int:
        """Take a message; return the size of its data, which may not change before `finish`."""
        entries = self._entries.get(channel_id)
        if entries is None:
            entries = self._entries[channel_id] = []
        entries.append(log_time_ns)
        entries.append(self.size_bytes)
        data_bytes = sum(map(len, parts))
        length = _MESSAGE_FIELDS_BYTES + data_bytes
        self._parts.append(
            _MESSAGE.pack(
                Opcode.MESSAGE, length, channel_id, sequence, log_time_ns, publish_time_ns
            )
        )
        self._parts += parts
        self.size_bytes += _MESSAGE.size + data_bytes
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
        compressed = self._compressor.compress(data)
        crc = zlib.crc32(data)
        chunk = Chunk(_COMPRESSION, compressed, last_ns, first_ns, crc, len(data))
        builder = RecordBuilder()
        chunk.write(builder)
        record = builder.end()
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
