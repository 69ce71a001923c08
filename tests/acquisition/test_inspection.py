"""What a recording holds, and what is wrong with it."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer

from acquisition.errors import StreamError
from acquisition.inspection import check, inspect
from acquisition.messages import codec
from drivers.samples import CanFrameSample, Sample
from tests.fakes.device_samples import can_frame, device_recording
from tests.fakes.foreign import IMAGE, INFO, POSE, foreign, parts
from tests.fakes.recordings import START_NS, depth_frame, pose, recording, samples


def file_of(tmp_path: Path, data: bytes) -> Path:
    path = tmp_path / "r.mcap"
    path.write_bytes(data)
    return path


Findings = set[tuple[str, str]]


def findings(tmp_path: Path, content: Sequence[Sample] | bytes, **options: Any) -> Findings:
    data = content if isinstance(content, bytes) else recording(content)
    return {(found.kind, found.topic) for found in check(file_of(tmp_path, data), **options)}


def test_a_summary_tells_rates_gaps_and_sizes(tmp_path: Path) -> None:
    content = [pose(i, START_NS + i * 10_000_000) for i in range(101) if i not in (50, 51)]
    summary = inspect(file_of(tmp_path, recording(content)))
    topic = next(t for t in summary.topics if t.topic == POSE)
    assert (topic.messages, topic.first_ns, topic.last_ns) == (99, START_NS, START_NS + 10**9)
    assert topic.rate_hz == pytest.approx(100.0)
    assert topic.largest_gap_s == pytest.approx(0.03)
    assert topic.size_bytes == 99 * len(codec.encode(pose(0))[0].cdr)
    assert summary.duration_s == pytest.approx(1.0)
    assert summary.size_bytes == (tmp_path / "r.mcap").stat().st_size
    lines = [line for line in summary.describe() if line.startswith("  /")]
    assert "  /mocap/pose     99 100.00 0.030 36.8  PoseWithCovarianceStamped" in lines


def test_a_summary_is_json(tmp_path: Path) -> None:
    damaged = bytearray(recording(samples(0.3)))
    damaged[len(damaged) // 2] ^= 1
    summary = inspect(file_of(tmp_path, bytes(damaged[:-20])))
    back = json.loads(json.dumps(summary.as_json()))
    assert back["metadata"]["terravibe"]["settings"] == '{"rate_hz": 30}'
    assert back["damaged"][0]["reason"]
    assert back["complete"] is False
    lines = summary.describe()
    assert any(line.startswith("damaged: ") for line in lines)
    assert any("no proper end" in line for line in lines)


def test_a_summary_fits_a_terminal_over_ssh(tmp_path: Path) -> None:
    lines = inspect(file_of(tmp_path, recording(samples(0.3)))).describe()[1:]
    assert max(map(len, lines)) <= 79
    assert not any("\n" in line for line in lines)
    (settings,) = [line for line in lines if "settings = " in line]
    assert settings.endswith('{"rate_hz": 30}')
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start()
    writer.add_metadata("rosbag2", {"serialized_metadata": "version: 5\n" * 50})
    writer.finish()
    (line,) = inspect(file_of(tmp_path, stream.getvalue())).describe()[1:]
    assert line.startswith("  rosbag2: serialized_metadata = version: 5 ver")
    assert line.endswith("... (549 characters; see --json)")
    assert len(line) == 79


def test_an_empty_recording_has_a_summary(tmp_path: Path) -> None:
    summary = inspect(file_of(tmp_path, recording([])))
    assert summary.duration_s == 0.0


def test_a_sound_recording_has_no_findings(tmp_path: Path) -> None:
    assert findings(tmp_path, samples(0.5)) == set()


def test_damage_and_truncation_are_found(tmp_path: Path) -> None:
    data = bytearray(recording(samples(0.5)))
    data[len(data) // 2] ^= 1
    assert ("damage", "") in findings(tmp_path, bytes(data))
    assert findings(tmp_path, recording(samples(0.5))[:-1]) == {("truncated", "")}


@pytest.mark.parametrize(
    ("numbers", "kinds"),
    [
        ([0, 1, 2, 3], set()),
        ([0, 1, 3, 4], {("sequence", POSE)}),
        ([0, 1, 1, 2], {("sequence", POSE)}),
        ([5, 6, 0, 1], {("sequence", POSE)}),
        ([0, 0, 0, 0], set()),
    ],
)
def test_missing_and_repeated_numbers_are_found(
    tmp_path: Path, numbers: list[int], kinds: Findings
) -> None:
    content = [pose(number, START_NS + i * 10**7) for i, number in enumerate(numbers)]
    assert findings(tmp_path, content) == kinds


def test_gaps_are_found(tmp_path: Path) -> None:
    times = [0, 1, 2, 3, 4, 10, 11]
    content = [pose(i, START_NS + t * 10**7) for i, t in enumerate(times)]
    assert findings(tmp_path, content) == {("gap", POSE)}
    assert findings(tmp_path, content, max_gap_periods=7.0) == set()


def frames(times_ms: Sequence[float]) -> list[CanFrameSample]:
    return [can_frame(i, START_NS + round(t * 10**6)) for i, t in enumerate(times_ms)]


def bursts(count: int, of: int, apart_ms: float) -> list[float]:
    return [apart_ms * burst + 0.2 * frame for burst in range(count) for frame in range(of)]


def arrivals(count: int) -> list[float]:
    steps_ms = np.random.default_rng(5).exponential(20.0, count)
    times_ms: list[float] = np.cumsum(steps_ms).tolist()
    return times_ms


@pytest.mark.parametrize("times_ms", [bursts(60, 4, 20.0), bursts(40, 150, 1000.0), arrivals(3000)])
def test_bursts_and_events_are_no_gaps(tmp_path: Path, times_ms: list[float]) -> None:
    assert findings(tmp_path, device_recording(frames(times_ms))) <= {("missing", "/tf_static")}


@pytest.mark.parametrize("times_ms", [bursts(60, 4, 20.0), bursts(40, 150, 1000.0), arrivals(3000)])
def test_a_silence_is_a_gap_in_bursts_and_events_too(tmp_path: Path, times_ms: list[float]) -> None:
    half = len(times_ms) // 2
    later = [t + 8000.0 for t in times_ms[half:]]
    data = device_recording(frames(times_ms[:half] + later))
    assert ("gap", "/can") in findings(tmp_path, data)


def test_a_beat_with_many_silences_has_gaps(tmp_path: Path) -> None:
    times_ms = [10.0 * i + 200.0 * (i // 100) for i in range(3000)]
    assert ("gap", "/can") in findings(tmp_path, device_recording(frames(times_ms)))


def test_time_that_goes_backwards_is_found(tmp_path: Path) -> None:
    content = [pose(i, START_NS + t * 10**7) for i, t in enumerate([0, 2, 1, 3])]
    assert findings(tmp_path, content) == {("order", POSE)}


def test_missing_topics_are_found(tmp_path: Path) -> None:
    data = foreign(parts(depth_frame(0), [IMAGE]))
    assert findings(tmp_path, data) == {("missing", INFO), ("missing", "/tf_static")}


def test_unprotected_and_unreadable_messages_are_found(tmp_path: Path) -> None:
    data = foreign([*parts(pose(0)), (POSE, b"\x00\x01", START_NS + 1)], enable_crcs=False)
    assert findings(tmp_path, data) >= {("unprotected", POSE), ("unreadable", POSE)}


def test_what_is_no_recording_is_an_error(tmp_path: Path) -> None:
    path = file_of(tmp_path, b"no recording at all")
    with pytest.raises(StreamError, match="expected an MCAP recording"):
        inspect(path)
    with pytest.raises(StreamError, match="expected an MCAP recording"):
        check(path)
