"""Files damaged in known ways, and what other readers save of them.

What is not faked: several kinds of damage in one file, and a disk that answers slowly.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader

HEAD = struct.Struct("<BQ")
MAGIC_BYTES = 8

# topic, type, log time, publish time, sequence, data
Told = tuple[str, str, int, int, int, bytes]


def records(data: bytes) -> list[tuple[int, int, int]]:
    """Return opcode, offset and end of every top-level record of an intact file."""
    found = []
    offset = MAGIC_BYTES
    while offset < len(data) - MAGIC_BYTES:
        opcode, length = HEAD.unpack_from(data, offset)
        found.append((opcode, offset, offset + HEAD.size + length))
        offset += HEAD.size + length
    return found


def content(data: bytes) -> list[tuple[int, int]]:
    """Return offset and end of every chunk, or of every message where there are no chunks."""
    found = records(data)
    for kind in (Opcode.CHUNK, Opcode.MESSAGE):
        if spans := [(start, end) for opcode, start, end in found if opcode == kind]:
            return spans
    return []


def cut_tail(data: bytes) -> bytes:
    """Return a file cut in the middle of a record in its second half."""
    start, end = content(data)[len(content(data)) * 3 // 4]
    return data[: (start + end) // 2]


def corrupt_payload(data: bytes) -> bytes:
    """Return a file with a changed byte inside a record in its middle."""
    start, end = content(data)[len(content(data)) // 2]
    return replaced(data, end - (end - start) // 4, bytes([data[end - (end - start) // 4] ^ 0xA5]))


def corrupt_length(data: bytes) -> bytes:
    """Return a file in which a record in its middle says that it is longer than it is."""
    start, end = content(data)[len(content(data)) // 2]
    return replaced(data, start + 1, struct.pack("<Q", end - start - HEAD.size + 70_000))


def absurd_length(data: bytes) -> bytes:
    """Return a file in which a record in its first quarter says that it has 2^62 bytes."""
    start, _ = content(data)[len(content(data)) // 4]
    return replaced(data, start + 1, struct.pack("<Q", 1 << 62))


def corrupt_first(data: bytes) -> bytes:
    """Return a file whose first chunk is damaged."""
    start, end = content(data)[0]
    return replaced(data, (start + end) // 2, bytes(8))


def zeroed_block(data: bytes) -> bytes:
    """Return a file with a block of zeros in its middle, as a power cut leaves it."""
    start, _ = content(data)[len(content(data)) // 2]
    block = start // 4096 * 4096
    return replaced(data, block, bytes(min(8192, len(data) - block)))


def zeroed_start(data: bytes) -> bytes:
    """Return a file without its first bytes: magic, header, part of the definitions."""
    return replaced(data, 0, bytes(64))


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "cut tail": cut_tail,
    "corrupt payload": corrupt_payload,
    "corrupt length field": corrupt_length,
    "absurd length field": absurd_length,
    "corrupt first chunk": corrupt_first,
    "zeroed block": zeroed_block,
    "zeroed start": zeroed_start,
}


def replaced(data: bytes, offset: int, piece: bytes) -> bytes:
    """Return the data with a piece overwritten."""
    return data[:offset] + piece + data[offset + len(piece) :]


def by_index(path: Path) -> Iterator[Told]:
    """Give what mcap's reader gives that uses the index, until it gives up."""
    with path.open("rb") as file:
        try:
            for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages(
                log_time_order=False
            ):
                yield told(channel, schema, message)
        except REFUSALS:
            return


def by_stream(path: Path) -> Iterator[Told]:
    """Give what a copy with mcap's `StreamReader` saves, until it gives up."""
    with path.open("rb") as file:
        yield from stream_messages(file)


def stream_messages(file: IO[bytes]) -> Iterator[Told]:
    """Give the messages of a stream in file order, until mcap's reader gives up."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    try:
        for record in StreamReader(file, validate_crcs=True).records:
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                channel = channels[record.channel_id]
                yield told(channel, schemas.get(channel.schema_id), record)
    except REFUSALS:
        return


REFUSALS = (
    McapError,
    OSError,
    struct.error,
    ValueError,
    KeyError,
    OverflowError,
    EOFError,
    RuntimeError,
    MemoryError,
    zstandard.ZstdError,
)


def told(channel: Channel, schema: Schema | None, message: Message) -> Told:
    """Return what makes two messages the same."""
    return (
        channel.topic,
        schema.name if schema else "",
        message.log_time,
        message.publish_time,
        message.sequence,
        message.data,
    )


def unpacked(data: bytes) -> list[Told]:
    """Return everything that an intact file says, in file order."""
    return list(stream_messages(io.BytesIO(data)))
