"""The health of a recording: its levels, and the views that are made of it."""

from __future__ import annotations

import io
import json
from dataclasses import replace

import pytest
from rich.console import Console

from acquisition.health.dashboard import Dashboard
from acquisition.health.diagnostics import DeviceStatus, Diagnostics, Level
from acquisition.health.snapshot import (
    HealthSnapshot,
    SourceHealth,
    StreamHealth,
    as_json,
    diagnostics_of,
    statistics_record,
    status_of,
)
from acquisition.health.stream_track import StreamStatistics
from acquisition.health.views import HealthLog, totals_of
from acquisition.messages import codec
from acquisition.recording.sample_queue import QueueState
from drivers.faults import Faults

FIGURES = StreamStatistics(4000, 0, 0, 0.0, 0.0, 0, 399.8, 400.0, 0.00021)
QUEUE = QueueState(3, 3072, 64_000_000, 9000, 0)
GYRO = SourceHealth(
    "gyro", "XV7001BB", "A7", "running", "", 0, 0.003, QUEUE,
    (StreamHealth("/gyro", FIGURES, 120_000, 0),), None, "",
)  # fmt: skip
DENIED = "cannot open /dev/ttyUSB0: permission denied; add yourself to the group dialout"
WHEELS = replace(GYRO, name="wheels", state="lost", error=DENIED, streams=())
SNAPSHOT = HealthSnapshot(1_700_000_000_000_000_000, 10.0, 5_000_000, 10**11, 0.012, (GYRO,), ())


def with_figures(**changes: object) -> SourceHealth:
    (stream,) = GYRO.streams
    figures = replace(FIGURES, **changes)  # type: ignore[arg-type] # names and values are below
    return replace(GYRO, streams=(replace(stream, statistics=figures),))


@pytest.mark.parametrize(
    ("source", "level", "text"),
    [
        (GYRO, Level.OK, "recording"),
        (WHEELS, Level.ERROR, DENIED),
        (replace(GYRO, state="hung"), Level.ERROR, "does not return"),
        (replace(GYRO, state="ended"), Level.STALE, "ended"),
        (replace(GYRO, losses=2), Level.WARN, "lost 2 times"),
        (replace(GYRO, queue=replace(QUEUE, dropped=7)), Level.WARN, "7 dropped, the writer"),
        (replace(GYRO, warning="no real-time priority"), Level.WARN, "no real-time"),
        (with_figures(rate_hz=320.0), Level.WARN, "/gyro: 320.0 Hz instead of 400.0"),
        (with_figures(rate_hz=None), Level.WARN, "/gyro: 0.0 Hz instead of 400.0"),
        (with_figures(gaps=2, gap_s=0.75), Level.WARN, "/gyro: 2 gaps of 0.75 s in all"),
        (with_figures(missed=3), Level.WARN, "/gyro: 3 missed"),
        (with_figures(backwards=1), Level.WARN, "1 stamps backwards"),
    ],
)
def test_every_problem_has_a_level_and_a_line(
    source: SourceHealth, level: Level, text: str
) -> None:
    found, line = status_of(source)
    assert found is level
    assert text in line
    assert "\n" not in line


def test_diagnostics_carry_every_figure_and_can_be_recorded() -> None:
    snapshot = replace(SNAPSHOT, sources=(GYRO, WHEELS), warnings=("disk slow",))
    said = diagnostics_of(snapshot)
    recorder, gyro, wheels = said.statuses
    assert (recorder.level, recorder.message) == (Level.WARN, "disk slow")
    assert recorder.values["free_bytes"] == "100000000000"
    assert (gyro.name, gyro.hardware_id, gyro.level) == ("gyro", "A7", Level.OK)
    assert gyro.values["/gyro rate_hz"] == "399.8"
    assert gyro.values["/gyro jitter_s"] == "0.00021"
    assert gyro.values["queue_bytes"] == "3072"
    assert "clock_skew_ppm" not in gyro.values
    assert wheels.level is Level.ERROR
    (encoded,) = codec.encode(said)
    row = codec.rows_of(Diagnostics)[0]
    assert codec.decode(row, encoded.cdr, log_time_ns=0, sequence=0) == said


def test_what_a_driver_counts_is_in_every_view() -> None:
    faults = Faults({"checksum_errors": 3, "resyncs": 0}, {"failed_transfers": 2})
    source = replace(GYRO, faults=faults)
    snapshot = replace(SNAPSHOT, sources=(source,))
    (_, said) = diagnostics_of(snapshot).statuses
    assert (said.level, said.message) == (Level.WARN, "3 checksum errors")
    assert (said.values["lost checksum_errors"], said.values["lost resyncs"]) == ("3", "0")
    assert said.faults() == faults
    (total,) = totals_of(snapshot)
    assert total.endswith("0 dropped, 3 checksum errors; mended: 2 failed transfers")
    assert "3 checksum errors; mended: 2 failed transfers" in HealthLog().lines(snapshot)[1]
    record = json.loads(statistics_record(snapshot)["source.gyro"])
    assert record["faults"]["lost"]["checksum_errors"] == 3
    only_mended = replace(source, faults=Faults({}, {"failed_transfers": 2}))
    assert status_of(only_mended)[0] is Level.OK


def test_values_of_others_are_no_counts() -> None:
    status = DeviceStatus(Level.OK, "x", "", "", {"lost track": "yes", "lost ticks": "4"})
    assert status.faults() == Faults({"ticks": 4})


def test_json_and_the_closing_record_are_json() -> None:
    assert json.loads(json.dumps(as_json(SNAPSHOT)))["sources"][0]["queue"]["dropped"] == 0
    record = statistics_record(SNAPSHOT)
    assert set(record) == {"recorder", "source.gyro"}
    assert json.loads(record["source.gyro"])["streams"][0]["statistics"]["samples"] == 4000


def test_a_log_names_the_topics_with_their_rates_and_says_who_is_in_trouble() -> None:
    gappy = replace(with_figures(gaps=2, gap_s=0.75), warning="no real-time priority")
    snapshot = replace(SNAPSHOT, sources=(GYRO, WHEELS), warnings=("disk slow",))
    assert HealthLog().lines(snapshot) == [
        "0:00:10 recorded, 5.0 MB written, 100.0 GB free",
        "WARN disk slow",
        "OK gyro: /gyro 399.8/400 Hz",
        f"ERROR wheels: {DENIED}",
    ]
    assert HealthLog().lines(replace(SNAPSHOT, sources=(gappy,)))[1:] == [
        "WARN gyro: /gyro 399.8/400 Hz, 2 gaps of 0.75 s in all; no real-time priority"
    ]


def test_a_name_that_begins_the_error_is_not_said_twice() -> None:
    error = "wheels (can0): network is down"
    snapshot = replace(SNAPSHOT, sources=(replace(WHEELS, error=error),))
    assert HealthLog().lines(snapshot)[1] == f"ERROR {error}"
    assert shown(snapshot, 80)[-1] == f"ERROR {error}"


def test_a_log_is_told_all_every_ten_seconds_and_a_change_at_once() -> None:
    log, lost = HealthLog(), replace(WHEELS, name="gyro")
    wheels = replace(WHEELS, state="running")
    usual = replace(SNAPSHOT, sources=(GYRO, wheels))
    assert [len(log.lines(usual)) for _ in range(11)] == [3, *[0] * 9, 3]
    assert log.lines(replace(usual, sources=(lost, wheels)))[1:] == [f"ERROR gyro: {DENIED}"]
    assert log.lines(replace(usual, sources=(lost, wheels), warnings=("disk slow",)))[1:] == [
        "WARN disk slow"
    ]


def test_a_long_line_of_a_log_goes_on_indented() -> None:
    (stream,) = GYRO.streams
    topics = [f"/topic{number}/of/a/recording" for number in range(9)]
    many = replace(GYRO, streams=tuple(replace(stream, topic=topic) for topic in topics))
    _, *lines = HealthLog().lines(replace(SNAPSHOT, sources=(many,)))
    assert max(map(len, lines)) <= 100
    assert lines[0].startswith("OK gyro: /topic0")
    assert all(line.startswith("    ") for line in lines[1:])
    assert all(f"{topic} 399.8/400 Hz" in " ".join(map(str.strip, lines)) for topic in topics)


def test_the_end_says_what_every_source_has_given() -> None:
    source = replace(with_figures(gaps=2, missed=3), losses=1, queue=replace(QUEUE, dropped=7))
    assert totals_of(replace(SNAPSHOT, sources=(source, WHEELS))) == [
        "  gyro: 4000 samples, 2 gaps, 3 missing, 7 dropped, lost 1 times",
        f"  wheels: nothing; {DENIED}",
    ]


def test_the_rate_of_a_devices_clock_is_shown_where_it_is_known() -> None:
    snapshot = replace(SNAPSHOT, sources=(replace(GYRO, clock_skew_ppm=-40.04),))
    assert HealthLog().lines(snapshot)[1] == "OK gyro: /gyro 399.8/400 Hz; clock -40.0 ppm"
    assert shown(snapshot, 120)[3].endswith(" -40.0")
    assert diagnostics_of(snapshot).statuses[1].values["clock_skew_ppm"] == "-40.04"


def shown(snapshot: HealthSnapshot, width: int) -> list[str]:
    """Return the dashboard as a terminal of that width shows it."""
    out = io.StringIO()
    Console(file=out, width=width).print(Dashboard(snapshot))
    return [line.rstrip() for line in out.getvalue().splitlines()]


def rover() -> HealthSnapshot:
    """Return five sources after hours, most of them in trouble."""

    def source(name: str, *streams: StreamHealth, **changes: object) -> SourceHealth:
        return replace(GYRO, name=name, streams=streams, **changes)  # type: ignore[arg-type] # below

    def stream(topic: str, rate_hz: float | None, **changes: object) -> StreamHealth:
        figures = replace(FIGURES, samples=86_400_000, rate_hz=rate_hz, **changes)  # type: ignore[arg-type] # below
        return StreamHealth(topic, figures, 0, 0)

    return replace(
        SNAPSHOT,
        sources=(
            source("vibration", stream("/vibration", None), state="lost", error=DENIED),
            source("gyro", stream("/gyro", 399.8), faults=Faults({}, {"failed_transfers": 2})),
            source("wheels", stream("/can", 1999.8, nominal_rate_hz=2000.0, jitter_s=0.0123),
                   stream("/wheels", 43.1, gaps=2, gap_s=1.75), losses=2),
            source("mocap", stream("/mocap/pose", 399.0, missed=123_456, gaps=31),
                   queue=replace(QUEUE, dropped=98765)),
            source("depth", stream("/depth/image", 400.0), stream("/acceleration", 400.0)),
        ),
        warnings=("disk almost full: 0.9 GB free on /data; free some room",),
    )  # fmt: skip


@pytest.mark.parametrize("width", [60, 80, 120])
def test_the_dashboard_is_whole_on_a_terminal(width: int) -> None:
    lines = shown(rover(), width)
    text = "\n".join(lines)
    words = " ".join(text.split())
    assert "…" not in text
    assert max(map(len, lines)) <= width
    assert len(lines) <= 24
    for line in (rover().warnings[0], f"ERROR vibration: {DENIED}", "OK gyro: mended: 2 failed"):
        assert line in words
    assert "WARN wheels: /wheels 43.1/400 Hz, 2 gaps of 1.75 s in all; lost 2 times" in words
    assert words.index("ERROR vibration") < words.index("WARN wheels") < words.index("OK gyro")


def test_a_wider_terminal_shows_more_columns() -> None:
    def row(width: int, topic: str) -> str:
        (line,) = [line for line in shown(rover(), width) if f" {topic} " in line.split(":")[0]]
        return " ".join(line.split())

    assert row(60, "/mocap/pose") == "mocap warning /mocap/pose 399.0/400 31 123456 98765"
    assert row(80, "/mocap/pose") == (
        "mocap warning /mocap/pose 399.0/400 0.21 86400000 31 123456 98765"
    )
    assert row(120, "/mocap/pose").endswith("86400000 31 0.00 123456 98765 0")
    assert row(80, "/can") == "wheels warning /can 2000/2000 12.30 86400000 0 0 0"
    assert row(80, "/vibration") == "vibration lost /vibration 0.0/400 0.21 86400000 0 0 0"


def test_the_dashboard_takes_names_literally_and_folds_long_ones() -> None:
    (stream,) = GYRO.streams
    unknown = replace(FIGURES, rate_hz=None, nominal_rate_hz=None, jitter_s=None)
    both = replace(
        GYRO,
        name="[bold]gyro",
        warning="[red]not as asked for",
        streams=(stream, StreamHealth("/gyro/temperature", unknown, 0, 0)),
    )
    silent = replace(GYRO, name="Q" * 30, state="opening", streams=())
    lines = shown(replace(SNAPSHOT, sources=(both, silent)), 80)
    text = "\n".join(lines)
    assert "[bold]gyro" in text
    assert "WARN [bold]gyro: [red]not as asked for" in lines
    assert text.count("Q") == 30
    assert "STALE" not in text
