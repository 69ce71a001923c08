"""The health of a recording for people: lines for a log, a table for a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from acquisition.health.diagnostics import Level
from acquisition.health.snapshot import HealthSnapshot, SourceHealth, status_of
from acquisition.health.stream_track import StreamStatistics

if TYPE_CHECKING:
    from rich.table import Table

_STYLES = {Level.OK: "green", Level.WARN: "yellow", Level.ERROR: "bold red", Level.STALE: "dim"}
_MB = 1e6
_COLUMNS = ("source", "topic", "rate", "jitter", "samples", "gaps", "missing", "dropped", "queue")


def title_of(snapshot: HealthSnapshot) -> str:
    """Return the recording in one line."""
    return (
        f"{snapshot.elapsed_s:.0f} s, {snapshot.bytes_written / _MB:.1f} MB, "
        f"{snapshot.free_bytes / _MB:.0f} MB free"
    )


def lines_of(snapshot: HealthSnapshot) -> list[str]:
    """Return the snapshot as plain lines: the recording, each source, each warning."""
    lines = [title_of(snapshot)]
    for source in snapshot.sources:
        level, text = _state(source)
        rates = " ".join(_rate(stream.statistics) for stream in source.streams)
        lines.append(f"{level.name} {source.name}: {' '.join(filter(None, (rates, text)))}")
    return lines + [f"WARN {warning}" for warning in snapshot.warnings]


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
    return f"{samples} samples, {lost}{away}{counted}{_mended(source)}"


def _mended(source: SourceHealth) -> str:
    """Return what went wrong without a loss, to stand behind other words."""
    repairs = source.faults.repairs()
    return f"; mended: {', '.join(repairs)}" if repairs else ""


def table_of(snapshot: HealthSnapshot) -> Table:
    """Return the snapshot as a rich table, to be shown by whoever owns the terminal."""
    from rich.table import Table
    from rich.text import Text

    table = Table(title=title_of(snapshot), caption="\n".join(snapshot.warnings))
    for name in (*_COLUMNS, "state"):
        table.add_column(name, justify="right" if name in _COLUMNS[2:] else "left")
    for source in snapshot.sources:
        level, text = _state(source)
        for number, row in enumerate(_rows(source)):
            state = Text(text if number == 0 else "", style=_STYLES[level])
            table.add_row(*(Text(cell) for cell in row), state)
    return table


def _state(source: SourceHealth) -> tuple[Level, str]:
    """Return how bad it is, and one line: why, what was mended, and how fast its clock runs."""
    level, text = status_of(source)
    text += _mended(source)
    skew_ppm = source.clock_skew_ppm
    return level, text if skew_ppm is None else f"{text}, clock {skew_ppm:+.1f} ppm"


def _rows(source: SourceHealth) -> list[tuple[str, ...]]:
    """Return one row for each stream, at least one; names and queue stand in the first."""
    queue = source.queue
    share = f"{100 * queue.size_bytes / queue.limit_bytes:.0f} %"
    rows = []
    for stream in source.streams:
        s = stream.statistics
        jitter = "" if s.jitter_s is None else f"{s.jitter_s * 1e3:.2f} ms"
        figures = (str(s.samples), str(s.gaps), str(s.missed))
        rows.append((source.name, stream.topic, _rate(s), jitter, *figures))
    rows = rows or [(source.name, "", "", "", "", "", "")]
    whole = [(str(queue.dropped), share)] + [("", "")] * (len(rows) - 1)
    return [row + end for row, end in zip(rows, whole, strict=True)]


def _rate(statistics: StreamStatistics) -> str:
    rate = f"{statistics.rate_hz or 0.0:.1f}"
    nominal = statistics.nominal_rate_hz
    return f"{rate} Hz" if nominal is None else f"{rate}/{nominal:.0f} Hz"
