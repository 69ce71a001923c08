"""The chunk index of a part: what comes out is what went in, in memory claimed beforehand."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import accumulate

import numpy as np
import pytest
from mcap.data_stream import RecordBuilder
from mcap.records import ChunkIndex

from acquisition.stream.index_store import IndexStore
from acquisition.stream.open_part import PartLimits, expected_index_bytes

PART_S = 60
CHUNKS_PER_S = 21
FLUSH_NS = 50_000_000


def indexes(chunks: int, topics: int = 10) -> Iterator[ChunkIndex]:
    """Give the entries of chunks whose lengths and times scatter as those of real ones."""
    rng = np.random.default_rng(0)
    lengths = rng.integers(100_000, 260_000, chunks).tolist()
    behind = rng.integers(500, 9000, (chunks, topics)).tolist()
    late_ns = rng.integers(0, 5_000_000, (chunks, 2)).tolist()
    starts = accumulate(lengths, initial=4000)
    for number, (start, length) in enumerate(zip(starts, lengths, strict=False)):
        first_ns = 1_700_000_000_000_000_000 + number * FLUSH_NS
        yield ChunkIndex(
            chunk_length=length,
            chunk_start_offset=start,
            compression="zstd",
            compressed_size=length - 53,
            message_end_time=first_ns + FLUSH_NS - late_ns[number][0],
            message_index_length=sum(behind[number]),
            message_index_offsets=dict(
                enumerate(accumulate(behind[number], initial=start + length), 1)
            ),
            message_start_time=first_ns + late_ns[number][1],
            uncompressed_size=6 * length,
        )


def plain(chunks: int) -> bytes:
    builder = RecordBuilder()
    for index in indexes(chunks):
        index.write(builder)
    data: bytes = builder.end()
    return data


def fill(store: IndexStore, chunks: int) -> None:
    for index in indexes(chunks):
        store.add(index)


@pytest.mark.parametrize("chunks", [0, 1, 400])
@pytest.mark.parametrize("expected_bytes", [0, 100, 1 << 20])
def test_it_gives_what_it_was_given_and_forgets_it(chunks: int, expected_bytes: int) -> None:
    store = IndexStore(expected_bytes)
    for _ in range(2):
        fill(store, chunks)
        assert b"".join(store.take()) == plain(chunks)
        assert store.used_bytes == 0
    fill(store, 400)
    store.clear()
    assert b"".join(store.take()) == b""


def test_the_memory_of_a_part_is_there_before_it_and_serves_the_next() -> None:
    expected = expected_index_bytes(PartLimits(duration_ns=PART_S * 10**9))
    store = IndexStore(expected)
    for _ in range(2):
        fill(store, PART_S * CHUNKS_PER_S)
        assert expected / 2 < store.used_bytes < expected == store.claimed_bytes
        store.clear()
    fill(store, 3 * PART_S * CHUNKS_PER_S)
    assert store.used_bytes == store.claimed_bytes > expected


def test_what_is_expected_stays_within_bounds() -> None:
    assert expected_index_bytes(PartLimits(size_bytes=10**9)) == 1 << 20
    assert expected_index_bytes(PartLimits(duration_ns=10**9)) == 1 << 16
    assert expected_index_bytes(PartLimits(duration_ns=10**18)) == 1 << 23
