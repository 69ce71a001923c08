"""How a recording is doing: one snapshot a second, from which every view is made."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, is_dataclass

from acquisition.health.diagnostics import DeviceStatus, Diagnostics, Level, fault_values
from acquisition.health.stream_track import StreamStatistics
from acquisition.recording.sample_queue import QueueState
from drivers.faults import NO_FAULTS, Faults

# A rate this far below the nominal one is worth a warning.
_RATE_TOLERANCE = 0.1


@dataclass(frozen=True, slots=True)
class StreamHealth:
    """One kind of sample of one source.

    Attributes:
        topic: where it is recorded.
        statistics: its figures.
        size_bytes: recorded so far, before compression.
        refused: samples that no message can express.
    """

    topic: str
    statistics: StreamStatistics
    size_bytes: int
    refused: int


@dataclass(frozen=True, slots=True)
class SourceHealth:
    """One source.

    Attributes:
        name: its name.
        model, serial: the device that answered; "" before it did.
        state: opening, ready, running, hung (its driver does not return), lost, ended, closed,
            or refused (it produces what another source produces).
        error: why it is not running, or "".
        losses: how often it was lost.
        silent_s: since its driver last returned.
        queue: how full its queue is, and what found no room in it.
        streams: what it produces.
        clock_skew_ppm: its clock against the host's, as in `ClockSample`; None while it is unknown.
        warning: what is not as it was asked for, or "".
        faults: what its driver lost and mended, by the driver's own count.
    """

    name: str
    model: str
    serial: str
    state: str
    error: str
    losses: int
    silent_s: float
    queue: QueueState
    streams: tuple[StreamHealth, ...]
    clock_skew_ppm: float | None
    warning: str
    faults: Faults = NO_FAULTS


@dataclass(frozen=True, slots=True)
class HealthSnapshot:
    """Everything at one time.

    Attributes:
        t_ns: log time.
        elapsed_s: since recording began.
        bytes_written: length of the recording.
        free_bytes: room on its disk.
        longest_write_s: the longest that the recorder was busy with one flush interval's samples
            during the last interval; the queues must last for it.
        sources: each source.
        warnings: what is wrong with the recording as a whole, one line each.
    """

    t_ns: int
    elapsed_s: float
    bytes_written: int
    free_bytes: int
    longest_write_s: float
    sources: tuple[SourceHealth, ...]
    warnings: tuple[str, ...]


def status_of(source: SourceHealth) -> tuple[Level, str]:
    """Return how bad it is, and one line that says why; the worst comes first."""
    if source.state in ("lost", "hung", "refused"):
        return Level.ERROR, source.error or "its driver does not return"
    if source.state in ("opening", "ready", "ended", "closed"):
        return Level.STALE, source.state
    problems = list(_losses(source))
    return (Level.WARN, "; ".join(problems)) if problems else (Level.OK, "recording")


def _losses(source: SourceHealth) -> list[str]:
    found = source_losses(source)
    for stream in source.streams:
        s, troubles = stream.statistics, stream_losses(stream)
        if is_slow(s):
            troubles.insert(0, f"{s.rate_hz or 0.0:.1f} Hz instead of {s.nominal_rate_hz:.1f}")
        if troubles:
            found.append(f"{stream.topic}: {', '.join(troubles)}")
    if source.warning:
        found.append(source.warning)
    return found


def source_losses(source: SourceHealth) -> list[str]:
    """Return what was lost of a source as a whole, each in words with its count."""
    found = []
    if source.queue.dropped:
        found.append(f"{source.queue.dropped} dropped, the writer is too slow")
    if source.losses:
        found.append(f"lost {source.losses} times")
    return found + source.faults.losses()


def stream_losses(stream: StreamHealth) -> list[str]:
    """Return what was lost of a stream, each in words with its count."""
    s = stream.statistics
    found = []
    if s.gaps:
        found.append(f"{s.gaps} gaps of {s.gap_s:.2f} s in all")
    if s.missed:
        found.append(f"{s.missed} missed")
    if s.backwards:
        found.append(f"{s.backwards} stamps backwards")
    if stream.refused:
        found.append(f"{stream.refused} not recordable")
    return found


def is_slow(statistics: StreamStatistics) -> bool:
    """Tell whether the rate is so far below the nominal one that it is worth a warning."""
    nominal_hz = statistics.nominal_rate_hz or 0.0
    return (statistics.rate_hz or 0.0) < (1.0 - _RATE_TOLERANCE) * nominal_hz


def as_json(snapshot: HealthSnapshot) -> dict[str, object]:
    """Return the snapshot as JSON values, under the names of its attributes."""
    return {name: _json_value(getattr(snapshot, name)) for name in snapshot.__dataclass_fields__}


def _json_value(value: object) -> object:
    """Return what `dataclasses.asdict` would, without its generators (see `monitor`)."""
    if is_dataclass(value):
        return {name: _json_value(getattr(value, name)) for name in value.__dataclass_fields__}
    if isinstance(value, tuple):
        return [_json_value(item) for item in value]
    return dict(value) if isinstance(value, Mapping) else value


def diagnostics_of(snapshot: HealthSnapshot) -> Diagnostics:
    """Return what goes to /diagnostics: the recorder first, then each source."""
    level = Level.WARN if snapshot.warnings else Level.OK
    values = {
        "elapsed_s": f"{snapshot.elapsed_s:.1f}",
        "bytes_written": str(snapshot.bytes_written),
        "free_bytes": str(snapshot.free_bytes),
        "longest_write_s": f"{snapshot.longest_write_s:.4f}",
    }
    text = "; ".join(snapshot.warnings) or "recording"
    recorder = DeviceStatus(level, "recorder", text, "", values)
    return Diagnostics(snapshot.t_ns, (recorder, *map(_device_status, snapshot.sources)))


def _device_status(source: SourceHealth) -> DeviceStatus:
    level, text = status_of(source)
    values: dict[str, object] = {
        "state": source.state,
        "losses": source.losses,
        "silent_s": source.silent_s,
        "queue_samples": source.queue.samples,
        "queue_bytes": source.queue.size_bytes,
        "dropped": source.queue.dropped,
        "clock_skew_ppm": source.clock_skew_ppm,
    }
    for stream in source.streams:
        s = stream.statistics
        figures = {name: getattr(s, name) for name in s.__dataclass_fields__} | {
            "size_bytes": stream.size_bytes,
            "refused": stream.refused,
        }
        values |= {f"{stream.topic} {name}": value for name, value in figures.items()}
    values |= fault_values(source.faults)
    return DeviceStatus(level, source.name, text, source.serial, _as_text(values))


def _as_text(values: Mapping[str, object]) -> dict[str, str]:
    """Return the values as text; floats to six digits, what is unknown left out."""
    return {
        key: f"{value:.6g}" if isinstance(value, float) else str(value)
        for key, value in values.items()
        if value is not None
    }


def statistics_record(snapshot: HealthSnapshot) -> dict[str, str]:
    """Return the metadata record that ends a recording: "recorder" and "source.NAME", as JSON."""
    whole = {"elapsed_s": snapshot.elapsed_s, "warnings": list(snapshot.warnings)}
    record = {"recorder": json.dumps(whole)}
    return record | {
        f"source.{source.name}": json.dumps(_json_value(source)) for source in snapshot.sources
    }
