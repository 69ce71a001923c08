"""The messages of one MCAP chunk: all of them, or the reason why none can be trusted."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from io import BytesIO
from typing import TypeVar

import lz4.frame  # type: ignore[import-untyped]  # it ships no annotations
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema

from acquisition.stream.checksum import crc32
from acquisition.stream.framing import HEAD

MAX_CHUNK_BYTES = 256 << 20
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_FIXED_BYTES = 40  # everything but the name of the compression and the data

Content = Schema | Channel | Message
_R = TypeVar("_R")


def parse(read: Callable[[ReadDataStream], _R], body: bytes) -> _R:
    """Return the record that `read`, one of mcap's record readers, finds in a body.

    Raises:
        ValueError: the body is not such a record.
    """
    try:
        return read(ReadDataStream(BytesIO(body)))
    except (struct.error, EndOfFile, OverflowError, UnicodeDecodeError) as error:
        raise ValueError(f"not a readable record ({type(error).__name__})") from error


def parse_message(body: bytes | memoryview) -> Message:
    """Return the message of a message record; one copy of its data.

    Raises:
        ValueError: the body is too short.
    """
    if len(body) < _MESSAGE_HEAD.size:
        raise ValueError(f"message record of {len(body)} bytes")
    channel_id, sequence, log_time, publish_time = _MESSAGE_HEAD.unpack_from(body)
    data = bytes(body[_MESSAGE_HEAD.size :])
    return Message(channel_id, log_time, data, publish_time, sequence)


def parse_chunk(body: bytes) -> Chunk:
    """Return the chunk of a chunk record, still compressed.

    Raises:
        ValueError: the body is not exactly one chunk.
    """
    chunk: Chunk = parse(Chunk.read, body)
    expected = _CHUNK_FIXED_BYTES + len(chunk.compression.encode()) + len(chunk.data)
    if expected != len(body):
        raise ValueError(f"chunk record of {len(body)} bytes holds a chunk of {expected}")
    return chunk


def open_chunk(chunk: Chunk, max_bytes: int = MAX_CHUNK_BYTES) -> list[Content]:
    """Return every schema, channel and message of a chunk, in their order.

    Raises:
        ValueError: checksum, compression or a record inside is wrong; the reason.
    """
    data = _decompress(chunk, max_bytes)
    if len(data) != chunk.uncompressed_size:
        raise ValueError(f"chunk holds {len(data)} bytes; it announced {chunk.uncompressed_size}")
    # 0 says that the writer computed no checksum.
    if chunk.uncompressed_crc not in (0, crc32(data)):
        raise ValueError("chunk checksum differs")
    return list(_contents(data))


def _decompress(chunk: Chunk, max_bytes: int) -> bytes:
    size = chunk.uncompressed_size
    if size > max_bytes:
        raise ValueError(f"chunk announces {size} bytes; at most {max_bytes} are accepted")
    if chunk.compression == "zstd":
        return _decompress_zstd(chunk.data, size)
    if chunk.compression == "lz4":
        return _decompress_lz4(chunk.data, size)
    if chunk.compression == "":
        return chunk.data
    raise ValueError(f"chunk compression {chunk.compression!r}; expected zstd, lz4 or none")


def _decompress_zstd(data: bytes, size: int) -> bytes:
    try:
        # The frame's own idea of its size decides what is allocated: -1 = it has none.
        if zstandard.frame_content_size(data) not in (-1, size):
            raise ValueError("chunk and its compressed data announce different sizes")
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
    except zstandard.ZstdError as error:
        raise ValueError(f"chunk does not decompress ({error})") from error


def _decompress_lz4(data: bytes, size: int) -> bytes:
    try:
        # One byte more than announced tells a longer chunk apart without unpacking it all.
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1))
    except (RuntimeError, EOFError) as error:
        raise ValueError(f"chunk does not decompress ({error})") from error


def _contents(data: bytes) -> Iterator[Content]:
    position = 0
    while position < len(data):
        if len(data) - position < HEAD.size:
            raise ValueError("chunk ends inside a record")
        opcode, length = HEAD.unpack_from(data, position)
        start = position + HEAD.size
        position = start + length
        if position > len(data):
            raise ValueError("chunk ends inside a record")
        if opcode == Opcode.MESSAGE:
            # A view, so that the data of an image is copied only once.
            yield parse_message(memoryview(data)[start:position])
        elif opcode == Opcode.SCHEMA:
            yield parse(Schema.read, data[start:position])
        elif opcode == Opcode.CHANNEL:
            yield parse(Channel.read, data[start:position])
