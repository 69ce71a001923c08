"""Truncation and damage: what is handed on is true, and what is not is told."""

from __future__ import annotations

import io
import random
import struct
import tracemalloc

import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.records import Chunk
from mcap.stream_reader import StreamReader as McapStreamReader

from acquisition.errors import StreamError
from acquisition.stream.byte_source import Pipe
from acquisition.stream.chunks import open_chunk
from acquisition.stream.framing import HEAD, RawRecord, RecordFramer
from acquisition.stream.read_report import Damage, ReadReport
from acquisition.stream.reader import StreamReader
from tests.fakes.recordings import fingerprint, reader_of, recording, samples

SAMPLES = samples(0.4)
DATA = recording(SAMPLES, flush_interval_ns=50_000_000)


def raw_records(data: bytes) -> list[RawRecord]:
    return list(RecordFramer(Pipe(io.BytesIO(data))).records())


def chunks(data: bytes) -> list[RawRecord]:
    return [record for record in raw_records(data) if record.opcode == Opcode.CHUNK]


def handed_on(data: bytes) -> tuple[list[object], StreamReader]:
    reader = reader_of(data)
    return fingerprint(reader), reader


WHOLE, _ = handed_on(DATA)


def flipped(data: bytes, position: int, bit: int = 0) -> bytes:
    changed = bytearray(data)
    changed[position] ^= 1 << bit
    return bytes(changed)


def test_every_cut_leaves_the_messages_before_it() -> None:
    cuts = random.Random(0).sample(range(8, len(DATA) - 1), 60)
    for cut in sorted([*cuts, 8, len(DATA) - 1]):
        messages, reader = handed_on(DATA[:cut])
        report = reader.report
        assert messages == WHOLE[: len(messages)]
        assert report.bytes_read + report.truncated_bytes == cut
        assert not report.complete
        assert not report.damaged
        assert any("no proper end" in line for line in report.describe())


def test_a_cut_loses_only_the_chunk_it_lies_in() -> None:
    third = chunks(DATA)[2]
    before, _ = handed_on(DATA[: third.offset])
    inside, reader = handed_on(DATA[: third.offset + 50])
    behind, _ = handed_on(DATA[: third.offset + third.length_bytes])
    assert inside == before
    assert reader.report.truncated_bytes == 50
    assert len(behind) > len(before)


@pytest.mark.parametrize("kind", [Opcode.MESSAGE_INDEX, Opcode.CHANNEL])
def test_a_bit_that_makes_a_message_of_another_record_makes_none(kind: Opcode) -> None:
    record = next(record for record in raw_records(DATA) if record.opcode == kind)
    data = bytearray(DATA)
    data[record.offset] = Opcode.MESSAGE
    assert (kind ^ Opcode.MESSAGE).bit_count() == 1
    messages, reader = handed_on(bytes(data))
    assert messages == WHOLE
    (damage,) = reader.report.damaged
    assert (damage.offset, damage.reason) == (
        record.offset,
        "message that has the form of another record",
    )
    assert not reader.report.skipped


@pytest.mark.parametrize("number", [0, 1, 3])
def test_a_damaged_chunk_is_left_out_whole_and_told(number: int) -> None:
    chunk = chunks(DATA)[number]
    damaged = flipped(DATA, chunk.offset + chunk.length_bytes // 2)
    messages, reader = handed_on(damaged)
    (damage,) = reader.report.damaged
    assert (damage.offset, damage.length_bytes) == (chunk.offset, chunk.length_bytes)
    assert damage.start_ns is not None
    assert damage.end_ns is not None
    inside = [
        bits
        for bits, message in zip(WHOLE, reader_of(DATA), strict=True)
        if damage.start_ns <= message.log_time_ns <= damage.end_ns
    ]
    missing = [bits for bits in WHOLE if bits not in messages]
    assert all(bits in inside for bits in missing)
    # At either end, samples of the same log time may lie in the neighbouring chunk.
    assert len(inside) - 4 <= len(missing) <= len(inside)
    assert [bits for bits in WHOLE if bits not in missing] == messages
    assert reader.report.complete
    assert any("checksum" in line or "decompress" in line for line in reader.report.describe())


def test_no_flipped_bit_goes_unnoticed_and_none_changes_a_message() -> None:
    chance = random.Random(1)
    outside = [i for r in raw_records(DATA) if r.opcode != Opcode.CHUNK for i in _span(r)]
    positions = chance.sample(outside, 150) + chance.sample(range(len(DATA)), 80)
    known = {repr(bits) for bits in WHOLE}
    for position in [*positions, *range(len(DATA) - 40, len(DATA))]:
        try:
            messages, reader = handed_on(flipped(DATA, position, chance.randrange(8)))
        except StreamError:
            continue
        assert {repr(bits) for bits in messages} <= known
        assert reader.report.damaged or not reader.report.complete, position


def _span(record: RawRecord) -> range:
    return range(record.offset, record.offset + record.length_bytes)


@settings(max_examples=150)
@given(st.data())
def test_nothing_but_stream_error_escapes_the_reader(draw: st.DataObject) -> None:
    data = bytearray(DATA)
    for _ in range(draw.draw(st.integers(1, 4))):
        start = draw.draw(st.integers(0, len(data) - 1))
        piece = draw.draw(st.binary(max_size=20))
        data[start : start + draw.draw(st.integers(0, 40))] = piece
    reader = reader_of(bytes(data))
    try:
        list(reader)
    except StreamError as error:
        lines = [str(error)]
    else:
        lines = reader.report.describe()
    assert all("\n" not in line for line in lines)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "holds nothing; expected an MCAP recording"),
        (DATA[:5], "holds only 5 bytes"),
        (b"PK\x03\x04\x00\x00\x00\x00rest", "starts with 50 4b 03 04"),
    ],
)
def test_what_is_no_recording_is_told_in_one_line(data: bytes, reason: str) -> None:
    with pytest.raises(StreamError, match=reason):
        list(reader_of(data))


@pytest.mark.parametrize(
    ("head", "reason"),
    [
        (HEAD.pack(0x06, 1 << 60), "record of 1152921504606846976 bytes"),
        (HEAD.pack(0x00, 10), "no record starts here"),
        (HEAD.pack(0x20, 10), "no record starts here"),
    ],
)
def test_where_the_framing_is_lost_reading_ends(head: bytes, reason: str) -> None:
    third = chunks(DATA)[2]
    data = DATA[: third.offset] + head + DATA[third.offset + HEAD.size :]
    messages, reader = handed_on(data)
    assert messages == handed_on(DATA[: third.offset])[0]
    (damage,) = reader.report.damaged
    assert reason in damage.reason
    assert damage.offset == third.offset
    assert damage.length_bytes == len(DATA) - third.offset == reader.report.truncated_bytes


def test_a_private_record_is_skipped() -> None:
    third = chunks(DATA)[2]
    data = DATA[: third.offset] + HEAD.pack(0x80, 3) + b"own" + DATA[third.offset :]
    messages, reader = handed_on(data)
    assert messages == WHOLE
    assert reader.report.complete


def first_chunk(**changes: object) -> Chunk:
    found = McapStreamReader(io.BytesIO(DATA), emit_chunks=True).records
    chunk = next(record for record in found if isinstance(record, Chunk))
    for name, value in changes.items():
        setattr(chunk, name, value)
    return chunk


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"uncompressed_size": 1 << 60}, "at most"),
        ({"uncompressed_size": 10}, "different sizes"),
        ({"compression": "snappy"}, "expected zstd, lz4 or none"),
        ({"compression": "lz4"}, "does not decompress"),
        ({"compression": ""}, "chunk holds"),
        ({"data": b"nonsense"}, "does not decompress"),
        ({"data": zstandard.compress(b"")}, "different sizes"),
        ({"uncompressed_crc": 1}, "chunk checksum differs"),
    ],
)
def test_a_chunk_that_is_not_what_it_announces_is_refused(
    changes: dict[str, object], reason: str
) -> None:
    with pytest.raises(ValueError, match=reason):
        open_chunk(first_chunk(**changes))


@pytest.mark.parametrize(
    "content",
    [
        HEAD.pack(Opcode.MESSAGE, 5) + b"short",
        HEAD.pack(Opcode.MESSAGE, 500) + bytes(30),
        HEAD.pack(Opcode.CHANNEL, 3) + bytes(3),
        HEAD.pack(Opcode.SCHEMA, 12) + struct.pack("<HIH", 1, 1 << 31, 0) + bytes(4),
        bytes(4),
    ],
)
def test_a_chunk_with_bad_records_inside_is_refused(content: bytes) -> None:
    chunk = Chunk("", content, 0, 0, 0, len(content))
    with pytest.raises(ValueError, match="record"):
        open_chunk(chunk)


def test_absurd_lengths_do_not_take_memory() -> None:
    bomb = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(1 << 28))
    chunk = Chunk("zstd", bomb, 0, 0, 0, 1000)
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match="chunk"):
            open_chunk(chunk)
        peak_bytes = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak_bytes < 1_000_000


def test_what_was_not_handed_on_is_told() -> None:
    damage = Damage(100, 20, "checksum differs")
    whole = ReadReport("a.mcap", 900, {}, {}, 0, 0, 0, (), complete=True)
    assert whole.losses() == []
    lossy = ReadReport("a.mcap", 900, {}, {}, 3, 0, 7, (damage,), complete=False)
    damaged, cut_short, late = lossy.losses("; wait longer")
    assert damaged == "not used, damaged: 20 bytes at offset 100: checksum differs"
    assert "900 bytes; 7 bytes behind it were not used" in cut_short
    assert late.startswith("3 messages")
    assert late.endswith("not used; wait longer")
