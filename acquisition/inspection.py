"""What a recording holds, and whether something is wrong with it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.editing.survey import Survey, TopicLog, survey
from acquisition.messages.codec import IMAGE_TOPIC
from acquisition.messages.depth_rvl import RVL_TOPIC
from acquisition.stream.read_report import Damage
from drivers.faults import Faults

MAX_GAP_PERIODS = 5.0
# A stream whose longer periods are more than twice its median comes with events, not with a beat;
# what is usual for it is told by its longest periods but one in a hundred.
_BEAT_QUANTILE, _BEAT_RATIO = 0.9, 2.0
_EVENT_QUANTILE, _EVENTS = 0.99, 100
# So many pauses, alike and filling most of the time, are how the stream is sent: in bursts.
_BURSTS = 20
_COLUMNS = 79  # of a line for people, who look at it over ssh too


@dataclass(frozen=True, slots=True)
class TopicSummary:
    """One topic of a recording.

    Attributes:
        topic: its name.
        ros_type: its type.
        messages: how many.
        first_ns: log time of the first message in the file.
        last_ns: log time of the last message in the file.
        rate_hz: 1 / median period, but of a stream without a beat its messages over its time; None
            with fewer than two different times.
        largest_gap_s: longest time between neighbours in log time; None with one message.
        size_bytes: sum of the messages before compression.
    """

    topic: str
    ros_type: str
    messages: int
    first_ns: int
    last_ns: int
    rate_hz: float | None
    largest_gap_s: float | None
    size_bytes: int


@dataclass(frozen=True, slots=True)
class RecordingSummary:
    """A recording in short.

    Attributes:
        path: the file.
        size_bytes: its length.
        duration_s: from the earliest to the latest log time; 0 when it holds no message.
        topics: one summary each, by name.
        metadata: the metadata records, by name.
        damaged: parts that cannot be used.
        truncated_bytes: bytes behind the last complete record.
        complete: the proper end is there.
        faults: what each source's driver lost and mended, by the last health record.
    """

    path: str
    size_bytes: int
    duration_s: float
    topics: tuple[TopicSummary, ...]
    metadata: Mapping[str, Mapping[str, str]]
    damaged: tuple[Damage, ...]
    truncated_bytes: int
    complete: bool
    faults: Mapping[str, Faults]

    def as_json(self) -> dict[str, object]:
        """Return the summary as JSON values, under the names of its attributes."""
        return asdict(self)

    def describe(self) -> list[str]:
        """Return the summary as lines for people."""
        lines = [f"{self.path}: {self.size_bytes} bytes, {self.duration_s:.3f} s"]
        lines += _topic_table(self.topics)
        for name, faults in self.faults.items():
            lines += [f"  {name} lost: {text}" for text in faults.losses()]
            lines += [f"  {name} mended: {text}" for text in faults.repairs()]
        for name, record in self.metadata.items():
            lines += [_metadata_line(f"  {name}: {key} = ", value) for key, value in record.items()]
        lines += [f"damaged: {damage.describe()}" for damage in self.damaged]
        if not self.complete:
            lines.append(f"no proper end; {self.truncated_bytes} bytes are left over")
        return lines


@dataclass(frozen=True, slots=True)
class Finding:
    """Something wrong with a recording.

    Attributes:
        kind: "damage", "truncated", "unreadable", "order", "sequence", "gap", "missing",
            "unprotected" or "device".
        topic: where, or the source's name for "device"; "" when it concerns the file.
        text: what, as one line.
    """

    kind: str
    topic: str
    text: str

    def describe(self) -> str:
        """Return one line."""
        return ": ".join(part for part in (self.kind, self.topic, self.text) if part)


def inspect(path: Path) -> RecordingSummary:
    """Summarise a recording.

    Raises:
        StreamError: the file cannot be read or is no recording.
    """
    found = survey(path)
    topics = tuple(_summary(topic, log) for topic, log in found.topics.items())
    first_ns = min((min(log.log_times_ns) for log in found.topics.values()), default=0)
    last_ns = max((max(log.log_times_ns) for log in found.topics.values()), default=0)
    return RecordingSummary(
        path=str(path),
        size_bytes=found.size_bytes,
        duration_s=(last_ns - first_ns) * 1e-9,
        topics=topics,
        metadata=found.metadata,
        damaged=found.damaged,
        truncated_bytes=found.truncated_bytes,
        complete=found.complete,
        faults=found.faults(),
    )


def _periods_ns(log: TopicLog) -> NDArray[np.uint64]:
    """Return the times between neighbours in log time, without those of equal time."""
    times_ns = np.sort(np.array(log.log_times_ns, dtype=np.uint64))
    periods_ns = times_ns[1:] - times_ns[:-1]
    return periods_ns[periods_ns > 0]


def _summary(topic: str, log: TopicLog) -> TopicSummary:
    periods = _periods_ns(log)
    return TopicSummary(
        topic=topic,
        ros_type=log.ros_type,
        messages=len(log.log_times_ns),
        first_ns=log.log_times_ns[0],
        last_ns=log.log_times_ns[-1],
        rate_hz=_rate_hz(periods, len(log.log_times_ns)) if periods.size else None,
        largest_gap_s=float(periods.max() * 1e-9) if periods.size else None,
        size_bytes=log.size_bytes,
    )


def _rate_hz(periods: NDArray[np.uint64], messages: int) -> float:
    if _has_beat(periods):
        return float(1e9 / np.median(periods))
    return float(1e9 * (messages - 1) / periods.sum())


def _metadata_line(start: str, value: str) -> str:
    """Return a value of the metadata in one line: settings and statistics fill pages."""
    value = " ".join(value.split())
    if len(start) + len(value) <= _COLUMNS:
        return start + value
    end = f"... ({len(value)} characters; see --json)"
    return start + value[: max(0, _COLUMNS - len(start) - len(end))] + end


def _topic_table(topics: Sequence[TopicSummary]) -> list[str]:
    """Return a line for each topic and one above them; the types without their package."""
    rows = [("topic", "number", "Hz", "gap s", "kB", "type"), *map(_cells, topics)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  " + " ".join([topic.ljust(widths[0]), *map(str.rjust, figures, widths[1:]), "", kind])
        for topic, *figures, kind in (rows if topics else ())
    ]


def _cells(topic: TopicSummary) -> tuple[str, ...]:
    rate = "" if topic.rate_hz is None else f"{topic.rate_hz:.2f}"
    gap = "" if topic.largest_gap_s is None else f"{topic.largest_gap_s:.3f}"
    kind = topic.ros_type.rpartition("/")[2] or "no type"
    return topic.topic, str(topic.messages), rate, gap, f"{topic.size_bytes / 1000:.1f}", kind


def check(path: Path, *, max_gap_periods: float = MAX_GAP_PERIODS) -> list[Finding]:
    """Return everything that is wrong with a recording; empty when it is sound.

    Args:
        path: the file.
        max_gap_periods: a longer time without a message, in usual periods, is a finding. Usual is
            the median for a stream that comes with a beat, more for one that comes with events.

    Raises:
        StreamError: the file cannot be read or is no recording.
    """
    found = survey(path)
    findings = list(_file_findings(found))
    for topic, log in found.topics.items():
        findings += _message_findings(topic, log)
        findings += _sequence_findings(topic, log)
        findings += _gap_findings(topic, log, max_gap_periods)
    for name, faults in found.faults().items():
        findings += [
            Finding("device", name, f"its driver counted {text}") for text in faults.losses()
        ]
    return findings


def _file_findings(found: Survey) -> Iterator[Finding]:
    for damage in found.damaged:
        yield Finding("damage", "", damage.describe())
    if not found.complete:
        text = f"no proper end; {found.truncated_bytes} bytes are left over"
        yield Finding("truncated", "", text)
    if {IMAGE_TOPIC, RVL_TOPIC} & found.topics.keys() and "/depth/camera_info" not in found.topics:
        yield Finding("missing", "/depth/camera_info", "depth images without a camera message")
    if "/tf_static" not in found.topics:
        yield Finding("missing", "/tf_static", "nothing says how the sensors are mounted")


def _message_findings(topic: str, log: TopicLog) -> Iterator[Finding]:
    if log.unreadable:
        yield Finding("unreadable", topic, f"{log.unreadable} messages; {log.first_error}")
    if log.unprotected:
        yield Finding("unprotected", topic, f"{log.unprotected} messages have no checksum")
    times_ns = np.array(log.log_times_ns, dtype=np.uint64)
    backwards = int(np.count_nonzero(times_ns[1:] < times_ns[:-1]))
    if backwards:
        yield Finding("order", topic, f"log time goes backwards {backwards} times")


def _sequence_findings(topic: str, log: TopicLog) -> Iterator[Finding]:
    sequences = np.array(log.sequences, dtype=np.int64)
    if not sequences.any():
        return  # the program that recorded it gave no numbers
    steps = np.diff(sequences)
    repeated = int(np.count_nonzero(steps <= 0))
    missing = int((steps[steps > 1] - 1).sum())
    if repeated:
        yield Finding("sequence", topic, f"sequence repeats or goes back {repeated} times")
    if missing:
        yield Finding("sequence", topic, f"{missing} messages are missing by their sequence")


def _gap_findings(topic: str, log: TopicLog, max_gap_periods: float) -> Iterator[Finding]:
    periods = _periods_ns(log)
    if not periods.size:
        return
    limit_ns = max_gap_periods * _usual_period_ns(periods)
    gaps = periods[periods > limit_ns]
    if gaps.size and not _are_bursts(gaps, periods, max_gap_periods):
        longest_s, limit_s = gaps.max() * 1e-9, limit_ns * 1e-9
        text = f"{gaps.size} gaps of more than {limit_s:.3f} s, up to {longest_s:.3f} s"
        yield Finding("gap", topic, text)


def _usual_period_ns(periods: NDArray[np.uint64]) -> float:
    if _has_beat(periods) or periods.size < _EVENTS:
        return float(np.median(periods))
    return float(np.quantile(periods, _EVENT_QUANTILE, method="lower"))


def _has_beat(periods: NDArray[np.uint64]) -> bool:
    return bool(np.quantile(periods, _BEAT_QUANTILE) <= _BEAT_RATIO * np.median(periods))


def _are_bursts(
    gaps: NDArray[np.uint64], periods: NDArray[np.uint64], max_gap_periods: float
) -> bool:
    alike = bool(gaps.max() <= max_gap_periods * float(np.median(gaps)))
    return gaps.size >= _BURSTS and alike and bool(2 * gaps.sum() > periods.sum())
