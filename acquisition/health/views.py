"""The health of a recording in words: lines for a log, and the reasons of the dashboard."""

from __future__ import annotations

import textwrap
from datetime import timedelta

from acquisition.health.diagnostics import Level
from acquisition.health.snapshot import (
    HealthSnapshot,
    SourceHealth,
    is_slow,
    source_losses,
    status_of,
    stream_losses,
)
from acquisition.health.stream_track import StreamStatistics

_GB, _MB = 1e9, 1e6
_LOG_COLUMNS = 100
_LOG_EVERY = 10  # snapshots, one a second


def title_of(snapshot: HealthSnapshot) -> str:
    """Return the recording in one line: how long, how much, and the room that is left."""
    elapsed = timedelta(seconds=int(snapshot.elapsed_s))
    written, free = _size(snapshot.bytes_written), _size(snapshot.free_bytes)
    return f"{elapsed} recorded, {written} written, {free} free"


def _size(count: int) -> str:
    return f"{count / _GB:.1f} GB" if count >= _GB else f"{count / _MB:.1f} MB"


class HealthLog:
    """Chooses what a log is told: all now and then, a source at once when its state changes."""

    def __init__(self) -> None:
        """Begin: the first snapshot is told whole, and every tenth after it."""
        self._seen = 0
        self._states: dict[str, str] = {}
        self._warnings: tuple[str, ...] = ()

    def lines(self, snapshot: HealthSnapshot) -> list[str]:
        """Return the lines that are due, none perhaps; call it with every snapshot."""
        due = self._seen % _LOG_EVERY == 0
        self._seen += 1
        before, warned = self._states, self._warnings
        self._states = {source.name: source.state for source in snapshot.sources}
        self._warnings = snapshot.warnings
        sources = [s for s in snapshot.sources if due or before[s.name] != s.state]
        warnings = [w for w in snapshot.warnings if due or w not in warned]
        if not sources and not warnings:
            return []
        lines = [f"WARN {warning}" for warning in warnings] + [_log_line(s) for s in sources]
        return [title_of(snapshot), *(part for line in lines for part in _wrapped(line))]


def _wrapped(line: str) -> list[str]:
    return textwrap.wrap(
        line,
        _LOG_COLUMNS,
        subsequent_indent="    ",
        break_long_words=False,  # a path must stay one that can be copied
        break_on_hyphens=False,
    )


def _log_line(source: SourceHealth) -> str:
    level, text = status_of(source)
    if level in (Level.OK, Level.WARN):
        skew_ppm = source.clock_skew_ppm
        clock = "" if skew_ppm is None else f"clock {skew_ppm:+.1f} ppm"
        text = "; ".join(filter(None, [*_streams(source, all_of_them=True), *_rest(source), clock]))
    return _line(level, source.name, text)


def reasons_of(snapshot: HealthSnapshot) -> list[tuple[Level, str]]:
    """Return why sources are not fine and what their drivers mended, a line each, worst first."""
    reasons = []
    for source in snapshot.sources:
        level, text = status_of(source)
        if level in (Level.OK, Level.WARN):
            text = "; ".join([*_streams(source, all_of_them=False), *_rest(source)])
        if text and level is not Level.STALE:  # its state says it all
            reasons.append((level, _line(level, source.name, text)))
    return sorted(reasons, key=lambda reason: -reason[0])


def _line(level: Level, name: str, text: str) -> str:
    """Return the line; drivers begin their errors with their name, which need not be said twice."""
    said = text.startswith((f"{name}:", f"{name} "))
    return f"{level.name} {text}" if said else f"{level.name} {name}: {text}"


def _streams(source: SourceHealth, *, all_of_them: bool) -> list[str]:
    """Return each stream with its rate and what was lost of it, or those in trouble alone."""
    found = []
    for stream in source.streams:
        losses, s = stream_losses(stream), stream.statistics
        if all_of_them or losses or is_slow(s):
            found.append(", ".join([f"{stream.topic} {rate_of(s)} Hz", *losses]))
    return found


def _rest(source: SourceHealth) -> list[str]:
    """Return what else there is to say of a source: its losses, its warning, what was mended."""
    repairs = ", ".join(source.faults.repairs())
    warning = [source.warning] if source.warning else []
    return source_losses(source) + warning + ([f"mended: {repairs}"] if repairs else [])


def rate_of(statistics: StreamStatistics) -> str:
    """Return the rate and, where it is known, the nominal one behind a slash; in Hz."""
    rate_hz, nominal_hz = statistics.rate_hz or 0.0, statistics.nominal_rate_hz
    rate = f"{rate_hz:.0f}" if rate_hz >= 1000.0 else f"{rate_hz:.1f}"
    return rate if nominal_hz is None else f"{rate}/{nominal_hz:g}"


def totals_of(snapshot: HealthSnapshot) -> list[str]:
    """Return what each source has given in the whole recording, one line each."""
    return [f"  {source.name}: {_total(source)}" for source in snapshot.sources]


def _total(source: SourceHealth) -> str:
    figures = [stream.statistics for stream in source.streams]
    samples = sum(s.samples for s in figures)
    if not samples:
        return f"nothing; {source.error or source.state}"
    gaps, missed = sum(s.gaps for s in figures), sum(s.missed for s in figures)
    lost = f"{gaps} gaps, {missed} missing, {source.queue.dropped} dropped"
    away = f", lost {source.losses} times" if source.losses else ""
    counted = "".join(f", {text}" for text in source.faults.losses())
    repairs = ", ".join(source.faults.repairs())
    mended = f"; mended: {repairs}" if repairs else ""
    return f"{samples} samples, {lost}{away}{counted}{mended}"
