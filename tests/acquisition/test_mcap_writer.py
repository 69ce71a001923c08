"""The writer of MCAP gives the very bytes that mcap's own Writer gives for the same calls."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import IO, Any, cast

from hypothesis import given
from hypothesis import strategies as st
from mcap.records import ChunkIndex, Statistics
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

from acquisition.stream.mcap_writer import McapWriter
from acquisition.stream.output import StreamOutput

uint64s = st.integers(0, 2**64 - 1)
messages = st.tuples(
    st.just("message"),
    st.integers(1, 3),
    uint64s,
    uint64s,
    st.integers(0, 2**32 - 1),
    st.lists(st.binary(max_size=300), max_size=3),
)
steps = st.lists(
    st.one_of(
        messages,
        st.tuples(st.just("flush")),
        st.tuples(st.just("metadata"), st.text(max_size=9), st.text(max_size=9)),
        st.tuples(st.just("channel"), st.text(max_size=9)),
    ),
    max_size=25,
)


def by_mcap(todo: list[Any], chunk_size_bytes: int) -> bytes:
    stream = io.BytesIO()
    # Only with this output in between is the checksum of the data section there.
    writer = Writer(cast(IO[bytes], StreamOutput(stream)), chunk_size=chunk_size_bytes)

    def add(channel: int, log_ns: int, publish_ns: int, sequence: int, parts: list[bytes]) -> None:
        writer.add_message(channel, log_ns, b"".join(parts), publish_ns, sequence)

    do_all(writer, add, todo)
    return stream.getvalue()


def by_ours(todo: list[Any], chunk_size_bytes: int) -> bytes:
    stream = io.BytesIO()
    writer = McapWriter(StreamOutput(stream), chunk_size_bytes)

    def add(channel: int, log_ns: int, publish_ns: int, sequence: int, parts: list[bytes]) -> None:
        size_bytes = writer.add_messages([channel], [tuple(parts)], log_ns, publish_ns, sequence)
        assert size_bytes == sum(map(len, parts))

    do_all(writer, add, todo)
    return stream.getvalue()


def do_all(writer: Any, add: Callable[..., None], todo: list[Any]) -> None:
    writer.start("ros2", "test")
    for number in range(3):
        schema = writer.register_schema(f"type {number}", "ros2msg", b"float64 x")
        writer.register_channel(f"/{number}", "cdr", schema)
    for kind, *values in todo:
        match kind:
            case "message":
                add(*values)
            case "flush":
                writer.flush()
            case "metadata":
                writer.add_metadata(values[0], {"key": values[1]})
            case "channel":
                writer.register_channel(values[0], "cdr", 1)
    writer.finish()


@given(steps, st.sampled_from([100, 1000, 1 << 20]))
def test_the_same_calls_give_the_same_bytes(todo: list[Any], chunk_size_bytes: int) -> None:
    assert by_ours(todo, chunk_size_bytes) == by_mcap(todo, chunk_size_bytes)


def test_a_long_recording_is_the_same_too() -> None:
    image = bytes(range(256)) * 2400
    todo: list[Any] = []
    for number in range(60):
        todo.append(("message", 1, 10**9 + number, 10**9, number, [image[number:], b"x"]))
        todo += [("message", 2, 10**9 + number + i, 10**9, i, [b"abcd"]) for i in range(40)]
        todo.append(("flush",))
    data = by_ours(todo, 1 << 20)
    assert data == by_mcap(todo, 1 << 20)
    found = list(StreamReader(io.BytesIO(data), emit_chunks=True, validate_crcs=True).records)
    (statistics,) = (record for record in found if isinstance(record, Statistics))
    assert statistics.message_count == 60 * 41
    assert sum(isinstance(record, ChunkIndex) for record in found) == 60
