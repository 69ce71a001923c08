"""The health of a recording on a terminal: whole on 80 columns and 24 lines.

What matters less is left out of narrower terminals; wider ones show more. A terminal that is too
low cuts the end off, so that the worst stands first among the reasons.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Table
from rich.text import Text

from acquisition.health.diagnostics import Level
from acquisition.health.snapshot import HealthSnapshot, SourceHealth, StreamHealth, status_of
from acquisition.health.views import rate_of, reasons_of, title_of

_STYLES = {Level.OK: "green", Level.WARN: "yellow", Level.ERROR: "bold red", Level.STALE: "dim"}
_ROOMY = 118  # two spaces between the columns


@dataclass(frozen=True, slots=True)
class Dashboard:
    """A snapshot as rich shows it, in the width that there is; names and errors literally."""

    snapshot: HealthSnapshot

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the recording, a row for each stream, and full lines for what is not fine."""
        del console  # the width is among the options
        yield Text(title_of(self.snapshot), style="bold")
        for warning in self.snapshot.warnings:
            yield Text(f"WARN {warning}", style=_STYLES[Level.WARN])
        yield _table(self.snapshot, options.max_width)
        for level, reason in reasons_of(self.snapshot):
            yield Text(reason, style=_STYLES[level], overflow="fold")


class _Column(NamedTuple):
    """A column: its header, the narrowest terminal that has room for it, and what stands in it.

    What is said of a source as a whole stands in the first of its rows.
    """

    header: str
    from_width: int
    of_source: Callable[[SourceHealth], str] = lambda _: ""
    of_stream: Callable[[StreamHealth], str] = lambda _: ""


def _word(source: SourceHealth) -> str:
    """Return the state in one word that fits the column."""
    words = {Level.OK: "ok", Level.WARN: "warning"}
    return words.get(status_of(source)[0], source.state)


def _jitter_ms(stream: StreamHealth) -> str:
    jitter_s = stream.statistics.jitter_s
    return "" if jitter_s is None else f"{jitter_s * 1e3:.2f}"


def _queue_percent(source: SourceHealth) -> str:
    return f"{100 * source.queue.size_bytes / source.queue.limit_bytes:.0f}"


def _clock_ppm(source: SourceHealth) -> str:
    return "" if source.clock_skew_ppm is None else f"{source.clock_skew_ppm:+.1f}"


# The widths: 9 + 7 + 13 + 9 + 4 + 6 + 5 and six spaces are 59; then 6 + 1, 8 + 1, 5 + 1 and so on.
_NAMES = (
    _Column("source", 0, of_source=lambda source: source.name),
    _Column("state", 0, of_source=_word),
    _Column("topic", 0, of_stream=lambda stream: stream.topic),
)
_FIGURES = (
    _Column("rate Hz\n/nominal", 0, of_stream=lambda stream: rate_of(stream.statistics)),
    _Column("jitter\nms", 66, of_stream=_jitter_ms),
    _Column("samples", 76, of_stream=lambda stream: str(stream.statistics.samples)),
    _Column("gaps", 0, of_stream=lambda stream: str(stream.statistics.gaps)),
    _Column("longest\ngap s", 98, of_stream=lambda s: f"{s.statistics.longest_gap_s:.2f}"),
    _Column("missed", 0, of_stream=lambda stream: str(stream.statistics.missed)),
    _Column("drops", 0, of_source=lambda source: str(source.queue.dropped)),
    _Column("queue\n%", 84, of_source=_queue_percent),
    _Column("clock\nppm", 90, of_source=_clock_ppm),
)


def _table(snapshot: HealthSnapshot, width: int) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2 if width >= _ROOMY else 1, 0, 0))
    figures = [column for column in _FIGURES if width >= column.from_width]
    for column in _NAMES:
        table.add_column(column.header, overflow="fold")
    for column in figures:
        table.add_column(column.header, justify="right", no_wrap=True)
    for source in snapshot.sources:
        style = _STYLES[status_of(source)[0]]
        for number, stream in enumerate(source.streams or (None,)):
            cells = [_cell(c, source, stream, first=number == 0) for c in (*_NAMES, *figures)]
            table.add_row(*[Text(cell) for cell in cells], style=style)
    return table


def _cell(
    column: _Column, source: SourceHealth, stream: StreamHealth | None, *, first: bool
) -> str:
    of_source = column.of_source(source) if first else ""
    return of_source or (column.of_stream(stream) if stream else "")
