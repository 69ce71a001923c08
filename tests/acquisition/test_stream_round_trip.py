"""Writer and reader together: what goes in comes out, however it is cut and delivered."""

from __future__ import annotations

import io
import random

import pytest

from acquisition.messages.frames import StaticTransforms
from acquisition.stream.reader import StreamReader
from drivers.samples import DepthFrame
from tests.fakes.recordings import (
    MOUNT,
    START_NS,
    depth_frame,
    fingerprint,
    pose,
    reader_of,
    recording,
    same,
    samples,
)


class Dribble:
    """A byte source that hands on as few or many bytes as it likes."""

    name = "dribble"

    def __init__(self, data: bytes, seed: int) -> None:
        self._data = io.BytesIO(data)
        self._random = random.Random(seed)

    def read(self, max_bytes: int) -> bytes:
        return self._data.read(min(max_bytes, self._random.choice((1, 7, 100, 4000, 1 << 20))))

    def skip_rest(self) -> int:
        return len(self._data.read())


def test_what_is_written_is_read_bit_for_bit_and_in_order() -> None:
    content = samples(1.0)
    reader = reader_of(recording(content))
    transforms, *messages = list(reader)

    assert same(transforms.sample, StaticTransforms(START_NS, (MOUNT,)))
    assert len(messages) == len(content)
    for message, sample in zip(messages, content, strict=True):
        assert same(message.sample, sample)
        assert (message.log_time_ns, message.sequence) == (sample.t_ns, sample.sequence)
    assert reader.report.complete
    assert not reader.report.damaged
    assert reader.report.truncated_bytes == 0
    assert reader.report.unprotected_messages == 0
    assert reader.report.bytes_read == len(recording(content))


@pytest.mark.parametrize("seed", range(5))
def test_neither_cutting_nor_delivery_changes_what_is_read(seed: int) -> None:
    content = samples(1.0)
    whole = fingerprint(list(reader_of(recording(content))))
    options = random.Random(seed)
    cut = recording(
        content,
        chunk_size_bytes=options.choice((1, 500, 20_000)),
        flush_interval_ns=options.choice((0, 10**7, 10**12)),
    )
    assert fingerprint(list(StreamReader(Dribble(cut, seed)))) == whole


def test_a_whole_frame_arrives_at_once() -> None:
    frame = next(
        m.sample for m in reader_of(recording([depth_frame(3)])) if m.topic == "/depth/image"
    )
    assert isinstance(frame, DepthFrame)
    assert not frame.depth_mm.flags.writeable


def test_messages_leave_in_order_of_log_time_within_the_window() -> None:
    late_by = [0, 30, -20, 60, 40, 100]
    content = [pose(i, START_NS + d * 1_000_000) for i, d in enumerate(late_by)]
    reader = reader_of(recording(content), reorder_window_ns=50_000_000)
    assert [m.sequence for m in list(reader)[1:]] == [2, 0, 1, 4, 3, 5]
    assert reader.report.late_messages == 0


def test_messages_later_than_the_window_are_counted_not_handed_on() -> None:
    content = [
        pose(0),
        pose(1, START_NS + 10**9),
        pose(2, START_NS + 2 * 10**9),
        pose(3, START_NS + 5),
    ]
    reader = reader_of(recording(content))
    assert [m.sequence for m in list(reader)[1:]] == [0, 1, 2]
    assert reader.report.late_messages == 1
    assert any("enlarge the reorder window" in line for line in reader.report.describe())


def test_metadata_tells_how_the_recording_was_made() -> None:
    reader = reader_of(recording([pose(0)]))
    list(reader)
    record = reader.metadata["terravibe"]
    assert record["settings"] == '{"rate_hz": 30}'
    assert '"model": "made of numbers"' in record["source.fake"]
    assert '"numpy"' in record["versions"]
