"""Recovery: everything intact is saved, nothing else is, and the report tells the difference."""

from __future__ import annotations

import io
import json
import random
import tempfile
import tracemalloc
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from acquisition.errors import StreamError
from acquisition.inspection import check
from acquisition.recovery.recover import RECOVERY_METADATA_NAME, recover
from acquisition.recovery.report import RecoveryReport
from tests.fakes.damage import (
    DAMAGES,
    HEAD,
    Told,
    by_index,
    by_stream,
    content,
    records,
    replaced,
    stream_messages,
    unpacked,
)
from tests.fakes.recordings import recording, samples

DATA = recording(samples(1.0), chunk_size_bytes=4000)
SAID = unpacked(DATA)

FOREIGN: dict[str, dict[str, Any]] = {
    "zstd": {"compression": CompressionType.ZSTD},
    "lz4": {"compression": CompressionType.LZ4},
    "not compressed": {"compression": CompressionType.NONE},
    "no checksums": {"enable_crcs": False},
    "no chunks": {"use_chunking": False},
    "no chunks, checksum over all": {"use_chunking": False, "enable_data_crcs": True},
}


def foreign(**options: Any) -> bytes:
    """Return a recording of unknown types with metadata and an attachment between the messages."""
    stream = io.BytesIO()
    writer = Writer(stream, chunk_size=3000, **options)
    writer.start("other", "somebody")
    chance = random.Random(5)
    channels = [
        writer.register_channel(
            f"/t{i}", "json", writer.register_schema(f"T{i}", "jsonschema", b"{}")
        )
        for i in range(3)
    ]
    writer.register_channel("/bare", "json", 0, {"key": "value"})
    for i in range(400):
        writer.add_message(channels[i % 3], 1000 + i, chance.randbytes(100), 900 + i, i)
        if i == 200:
            writer.add_metadata("middle", {"a": "b"})
            writer.add_attachment(1, 2, "photo", "image/png", chance.randbytes(500))
    writer.finish()
    return stream.getvalue()


def run(data: bytes, folder: Path) -> tuple[RecoveryReport, list[Told], Path]:
    """Return the report, what the copy says, and where it is."""
    damaged, output = folder / "damaged.mcap", folder / "saved.mcap"
    damaged.write_bytes(data)
    report = recover(damaged, output)
    assert damaged.read_bytes() == data
    return report, unpacked(output.read_bytes()), output


def is_subsequence(part: list[Told], whole: list[Told]) -> bool:
    """Tell whether the part is the whole with some left out, in the same order."""
    rest = iter(whole)
    return all(message in rest for message in part)


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES.keys())
@pytest.mark.parametrize("compression", ["ours", "zstd", "lz4", "not compressed"])
def test_saves_at_least_what_others_save_and_never_a_wrong_message(
    damage: Callable[[bytes], bytes], compression: str, tmp_path: Path
) -> None:
    intact = DATA if compression == "ours" else foreign(**FOREIGN[compression])
    said = unpacked(intact)
    report, saved, output = run(damage(intact), tmp_path)
    assert is_subsequence(saved, said)
    truth = Counter(said)
    for other in (by_index, by_stream):
        theirs = Counter(other(tmp_path / "damaged.mcap")) & truth
        assert len(saved) >= theirs.total(), other.__name__
        assert not theirs - Counter(saved)
    assert sum(report.messages.values()) == len(saved) <= len(said)
    assert report.damaged or report.restored == 1
    assert not report.sound
    assert not report.unproven
    with output.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(saved)
    assert Counter(by_index(output)) == Counter(saved)


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES.keys())
def test_loses_no_chunk_but_the_damaged_ones(
    damage: Callable[[bytes], bytes], tmp_path: Path
) -> None:
    damaged = damage(DATA)
    _, saved, _ = run(damaged, tmp_path)
    intact = [
        piece
        for piece in _chunk_messages(DATA)
        # The head of a chunk can be restored.
        if damaged[piece[0] + HEAD.size : piece[1]] == DATA[piece[0] + HEAD.size : piece[1]]
    ]
    assert saved == [message for _, _, messages in intact for message in messages]


def _chunk_messages(data: bytes) -> list[tuple[int, int, list[Told]]]:
    """Return offset, end and messages of every chunk, by cutting behind each."""
    found = []
    before = 0
    for start, end in content(data):
        count = _messages_up_to(data[:end])
        found.append((start, end, SAID[before:count]))
        before = count
    return found


def _messages_up_to(data: bytes) -> int:
    return sum(1 for _ in stream_messages(io.BytesIO(data)))


def test_an_intact_recording_is_copied_whole(tmp_path: Path) -> None:
    report, saved, output = run(DATA, tmp_path)
    assert saved == SAID
    assert report.sound
    assert report.messages == report.expected
    assert report.describe()[-1] == "  1 metadata records, 0 attachments"
    assert check(output) == []
    with output.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        assert reader.get_header().profile == "ros2"
    assert set(metadata) == {"terravibe", RECOVERY_METADATA_NAME}
    assert metadata[RECOVERY_METADATA_NAME]["source"] == "damaged.mcap"


@pytest.mark.parametrize("options", FOREIGN.values(), ids=FOREIGN.keys())
def test_any_recording_keeps_everything_it_holds(options: dict[str, Any], tmp_path: Path) -> None:
    intact = foreign(**options)
    report, saved, output = run(intact, tmp_path)
    assert saved == unpacked(intact)
    assert report.sound
    assert (report.metadata, report.attachments) == (1, 1)
    vouched = options.get("use_chunking", True) or options.get("enable_data_crcs", False)
    unproven = 0 if vouched and options.get("enable_crcs", True) else 400
    assert sum(report.unproven.values()) == unproven
    with output.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "other"
        (attachment,) = reader.iter_attachments()
        summary = reader.get_summary()
    assert (attachment.name, attachment.create_time, attachment.log_time) == ("photo", 1, 2)
    assert summary is not None
    assert {c.topic: c.metadata for c in summary.channels.values()}["/bare"] == {"key": "value"}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES.keys())
def test_messages_outside_chunks_are_saved_around_the_damage(
    damage: Callable[[bytes], bytes], tmp_path: Path
) -> None:
    intact = foreign(use_chunking=False)
    said = unpacked(intact)
    report, saved, _ = run(damage(intact), tmp_path)
    wrong = Counter(saved) - Counter(said)
    # Nothing protects the payload of these messages; everything else about them is checked.
    assert wrong.total() == (damage in (DAMAGES["corrupt payload"], DAMAGES["corrupt first chunk"]))
    assert sum(report.unproven.values()) == len(saved)
    assert "messages have no checksum, or none" in "\n".join(report.describe())
    theirs = Counter(by_stream(tmp_path / "damaged.mcap")) & Counter(said)
    assert (Counter(saved) & Counter(said)).total() >= theirs.total()


def test_what_an_uncompressed_damaged_chunk_holds_is_not_taken_for_messages(tmp_path: Path) -> None:
    intact = foreign(compression=CompressionType.NONE)
    start, end = content(intact)[2]
    damaged = replaced(intact, start, bytes(9))  # its head is gone, its messages lie open
    damaged = replaced(damaged, end - 50, b"\xff")
    report, saved, _ = run(damaged, tmp_path)
    assert is_subsequence(saved, unpacked(intact))
    assert any("what a damaged chunk held" in damage.reason for damage in report.damaged)
    # The messages of the chunk lie side by side and are told as one.
    assert len(report.damaged) == 2


@pytest.mark.parametrize("kind", [Opcode.MESSAGE_INDEX, Opcode.CHANNEL, Opcode.HEADER])
def test_a_bit_does_not_make_a_message_of_another_record(kind: Opcode, tmp_path: Path) -> None:
    for intact in (DATA, foreign(), foreign(use_chunking=False)):
        for opcode, offset, _ in records(intact):
            if opcode == kind:
                _, saved, _ = run(replaced(intact, offset, bytes([Opcode.MESSAGE])), tmp_path)
                assert is_subsequence(saved, unpacked(intact))
                break


def test_without_chunks_no_message_is_taken_for_an_index_of_one(tmp_path: Path) -> None:
    stream = io.BytesIO()
    writer = Writer(stream, use_chunking=False)
    writer.start()
    channel = writer.register_channel("/t", "json", 0)
    for sequence in range(200):  # that of 112 has the form of an index of seven messages
        writer.add_message(channel, sequence, bytes(96), sequence, sequence)
    writer.finish()
    report, saved, _ = run(stream.getvalue(), tmp_path)
    assert len(saved) == 200
    assert report.sound


@pytest.mark.parametrize("name", ["not compressed", "no chunks"])
def test_what_only_looks_like_a_record_of_an_unknown_kind_takes_nothing_along(
    name: str, tmp_path: Path
) -> None:
    data = foreign(**FOREIGN[name])
    whole = unpacked(data)
    for place in (10478, 14467, 22448):
        # Behind one byte too many, the last byte of a record and the next one's head are a head.
        report, saved, _ = run(data[:place] + data[place - 1 :], tmp_path)
        assert len(saved) >= len(whole) - 30, place  # those of the chunk that was hit
        # Nothing vouches for a message outside chunks, here the one that was hit.
        assert (Counter(saved) - Counter(whole)).total() <= (name == "no chunks")
        assert report.skipped_bytes < 4000, place


def test_a_chunk_whose_checksum_is_gone_is_not_trusted(tmp_path: Path) -> None:
    start, _ = content(DATA)[3]
    damaged = replaced(DATA, start + 9 + 24, bytes(4))
    report, saved, _ = run(damaged, tmp_path)
    assert is_subsequence(saved, SAID)
    assert len(saved) < len(SAID)
    assert any("without a checksum" in damage.reason for damage in report.damaged)


@pytest.mark.parametrize(
    ("offset", "piece"),
    [(0, b"\x00"), (1, b"\x01" * 8), (0, bytes(9 + 16)), (9 + 16, b"\xff" * 8)],
    ids=["opcode", "length", "all before the sizes", "size"],
)
def test_a_chunk_is_saved_when_only_its_head_is_damaged(
    offset: int, piece: bytes, tmp_path: Path
) -> None:
    start, _ = content(DATA)[4]
    report, saved, _ = run(replaced(DATA, start + offset, piece), tmp_path)
    assert saved == SAID
    assert report.doubted or report.restored == 1
    assert not report.sound


def test_a_chunk_behind_damage_is_found_by_the_index(tmp_path: Path) -> None:
    """The block ends behind the first bytes of a chunk: nothing looks like a record there."""
    start, _ = content(DATA)[4]
    damaged = replaced(DATA, start - 100, bytes(100 + 9))
    report, saved, _ = run(damaged, tmp_path)
    assert saved == SAID
    assert report.expected == report.messages
    # An index with a wrong bit is no proof, but still a hint.
    report, saved, _ = run(replaced(damaged, len(DATA) - 12, b"\0\0\0\0"), tmp_path)
    assert saved == SAID
    assert report.expected is None


def test_a_chunk_that_was_written_twice_is_copied_once(tmp_path: Path) -> None:
    start, end = content(DATA)[4]
    report, saved, _ = run(DATA[:end] + DATA[start:], tmp_path)
    assert saved == SAID
    assert [damage.reason for damage in report.damaged] == ["a chunk once more"]


def test_a_zstd_chunk_without_data_is_damage(tmp_path: Path) -> None:
    start, end = content(DATA)[4]
    empty = DATA[start + 9 : start + 9 + 36] + bytes(8)
    damaged = DATA[:start] + HEAD.pack(Opcode.CHUNK, len(empty)) + empty + DATA[end:]
    report, saved, _ = run(damaged, tmp_path)
    assert is_subsequence(saved, SAID)
    assert "decompress" in report.damaged[0].reason


def test_definitions_are_found_in_the_summary(tmp_path: Path) -> None:
    """mcap's writer defines channels in the first chunk and in the summary only."""
    intact = foreign()
    start, end = content(intact)[0]
    report, saved, _ = run(replaced(intact, start + 60, bytes(30)), tmp_path)
    first = len(unpacked(intact)) - len(saved)
    assert saved == unpacked(intact)[first:]
    assert not report.undefined
    (damage,) = report.damaged
    assert (damage.offset, damage.length_bytes) == (start, end - start)
    assert [chunk.offset for chunk in report.lost_chunks] == [start]
    assert (report.lost_chunks[0].start_ns, report.lost_chunks[0].end_ns) == (1000, 999 + first)
    (told,) = [line for line in report.describe() if f"at offset {start}:" in line]
    assert told.startswith("lost chunk: ")
    assert damage.reason in told
    assert f"log times 1000 to {999 + first} ns" in told


def test_what_nothing_defines_is_left_out_and_told(tmp_path: Path) -> None:
    intact = foreign()
    start, _ = content(intact)[0]
    damaged = replaced(intact, start + 60, bytes(30))[: content(intact)[5][1]]
    report, saved, _ = run(damaged, tmp_path)
    assert saved == []
    assert sum(report.undefined.values()) > 50
    assert "which nothing defines" in "\n".join(report.describe())


def test_a_topic_that_no_checksum_vouches_for_any_more_is_told(tmp_path: Path) -> None:
    intact = foreign()
    start, end = content(intact)[0]  # the only chunk that says what the numbers mean
    damaged = replaced(intact, (start + end) // 2, bytes(8))
    report, saved, _ = run(damaged, tmp_path)
    assert not report.unproven
    renamed = replaced(damaged, intact.rindex(b"/t0"), b"/u0")
    report, saved, _ = run(renamed, tmp_path)
    assert Counter(told[0] for told in saved) == report.unproven
    assert "or none for their topic's name" in report.describe()[-1]


def test_a_lost_schema_does_not_take_the_messages_along(tmp_path: Path) -> None:
    intact = foreign(use_chunking=False, repeat_schemas=False)
    schema = next(offset for opcode, offset, _ in records(intact) if opcode == Opcode.SCHEMA)
    report, saved, _ = run(replaced(intact, schema, b"\x00"), tmp_path)
    assert report.without_schema == ("/t0",)
    assert len(saved) == 400
    assert {name for topic, name, *_ in saved if topic == "/t0"} == {""}


def test_a_flipped_definition_outside_the_chunks_is_overruled(tmp_path: Path) -> None:
    offset = DATA.index(b"/mocap/pose")
    report, saved, _ = run(replaced(DATA, offset, b"/mockup/pos"), tmp_path)
    assert saved == SAID
    assert report.doubted
    assert not report.sound


def test_without_checksums_a_wrong_sum_over_all_is_told(tmp_path: Path) -> None:
    intact = foreign(use_chunking=False, enable_data_crcs=True)
    report, _, _ = run(DAMAGES["corrupt payload"](intact), tmp_path)
    assert report.doubted
    assert "checksum of the data differs" in "\n".join(report.describe())


def test_a_damaged_attachment_is_left_out(tmp_path: Path) -> None:
    intact = foreign()
    offset = next(start for opcode, start, _ in records(intact) if opcode == Opcode.ATTACHMENT)
    report, saved, _ = run(replaced(intact, offset + 200, b"\x00\x00"), tmp_path)
    assert (report.attachments, report.metadata) == (0, 1)
    assert saved == unpacked(intact)
    assert [damage.reason for damage in report.damaged] == ["attachment checksum differs"]


def test_a_damaged_metadata_record_is_left_out(tmp_path: Path) -> None:
    intact = foreign()
    offset = next(start for opcode, start, _ in records(intact) if opcode == Opcode.METADATA)
    report, saved, _ = run(replaced(intact, offset + 9, b"\x07"), tmp_path)
    assert (report.attachments, report.metadata) == (1, 0)
    assert saved == unpacked(intact)


def test_the_report_is_json_and_lists_offsets_and_times(tmp_path: Path) -> None:
    damaged = DAMAGES["corrupt payload"](DATA)
    report, saved, output = run(damaged, tmp_path)
    start, end = content(DATA)[len(content(DATA)) // 2]
    (damage,) = report.damaged
    assert (damage.offset, damage.length_bytes) == (start, end - start)
    assert report.skipped_bytes == end - start
    lost = [message for message in SAID if message not in saved]
    assert (damage.start_ns, damage.end_ns) == (lost[0][2], lost[-1][2])
    told = json.loads(json.dumps(report.as_json()))
    assert told["damaged"][0]["offset"] == start
    assert told["sound"] is False
    with output.open("rb") as file:
        metadata = {r.name: r.metadata for r in make_reader(file).iter_metadata()}
    assert json.loads(metadata[RECOVERY_METADATA_NAME]["damaged"])[0]["offset"] == start


def test_a_second_recording_behind_the_end_is_not_mixed_in(tmp_path: Path) -> None:
    report, saved, _ = run(DATA + foreign(), tmp_path)
    assert saved == SAID
    assert "behind the end" in report.damaged[0].reason


@pytest.mark.parametrize("data", [b"", b"\x89MCAP0\r\n", b"no recording at all" * 500])
def test_a_file_without_a_record_is_refused(data: bytes, tmp_path: Path) -> None:
    with pytest.raises(StreamError, match="holds no intact MCAP record; nothing was written"):
        run(data, tmp_path)
    assert not (tmp_path / "saved.mcap").exists()


def test_the_input_is_never_the_output(tmp_path: Path) -> None:
    path, link = tmp_path / "a.mcap", tmp_path / "b.mcap"
    path.write_bytes(DATA)
    link.symlink_to(path)
    for output in (path, link):
        with pytest.raises(StreamError, match="are the same file; give another name"):
            recover(path, output)
    assert path.read_bytes() == DATA


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(StreamError, match=r"cannot read .*none.mcap: No such file"):
        recover(tmp_path / "none.mcap", tmp_path / "out.mcap")


def test_progress_rises_to_one(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(DATA)
    seen: list[float] = []
    recover(tmp_path / "a.mcap", tmp_path / "b.mcap", progress=seen.append)
    assert seen == sorted(seen)
    assert 0.99 < seen[-1] <= 1.0


def test_every_cut_saves_every_whole_chunk(tmp_path: Path) -> None:
    ends = [(end, len(said)) for end, said in _running(DATA)]
    chance = random.Random(0)
    for cut in chance.sample(range(ends[0][0], len(DATA)), 25):
        _, saved, _ = run(DATA[:cut], tmp_path)
        whole = max(count for end, count in ends if end <= cut)
        assert saved == SAID[:whole]


def _running(data: bytes) -> list[tuple[int, list[Told]]]:
    messages: list[Told] = []
    found = []
    for _, end, inside in _chunk_messages(data):
        messages = messages + inside
        found.append((end, messages))
    return found


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_no_damage_gives_a_wrong_message(draw: st.DataObject) -> None:
    data = bytearray(DATA)
    for _ in range(draw.draw(st.integers(1, 4))):
        start = draw.draw(st.integers(0, len(data) - 1))
        piece = draw.draw(st.one_of(st.binary(max_size=20), st.integers(1, 9000).map(bytes)))
        length = draw.draw(st.sampled_from((len(piece), 0, 13)))  # overwritten, inserted, moved
        data[start : start + length] = piece
    with tempfile.TemporaryDirectory() as folder:
        try:
            report, saved, _ = run(bytes(data), Path(folder))
        except StreamError:
            return
    whole = [(*m[:1], "", *m[2:]) if m[0] in report.without_schema else m for m in SAID]
    assert is_subsequence(saved, whole)
    assert sum(report.messages.values()) == len(saved)


def test_memory_does_not_grow_with_the_file(tmp_path: Path) -> None:
    path = tmp_path / "large.mcap"
    body = random.Random(1).randbytes(200_000)
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=400_000, compression=CompressionType.NONE)
        writer.start()
        channel = writer.register_channel("/t", "", 0)
        for i in range(150):
            writer.add_message(channel, i, body, i)
    tracemalloc.start()
    try:
        report = recover(path, tmp_path / "saved.mcap")
        peak_bytes = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert report.messages["/t"] > 140
    assert path.stat().st_size > 28_000_000
    assert peak_bytes < 8_000_000
