"""The health of a recording: its levels, and the views that are made of it."""

from __future__ import annotations

import io
import json
from dataclasses import replace

import pytest
from rich.console import Console

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
from acquisition.health.views import lines_of, table_of, totals_of
from acquisition.messages import codec
from acquisition.recording.sample_queue import QueueState
from drivers.faults import Faults

FIGURES = StreamStatistics(4000, 0, 0, 0.0, 0.0, 0, 399.8, 400.0, 0.00021)
QUEUE = QueueState(3, 3072, 64_000_000, 9000, 0)
GYRO = SourceHealth(
    "gyro", "XV7001BB", "A7", "running", "", 0, 0.003, QUEUE,
    (StreamHealth("/gyro", FIGURES, 120_000, 0),), None, "",
)  # fmt: skip
WHEELS = replace(GYRO, name="wheels", state="lost", error="can0: network is down", streams=())
SNAPSHOT = HealthSnapshot(1_700_000_000_000_000_000, 10.0, 5_000_000, 10**11, 0.012, (GYRO,), ())


def with_figures(**changes: object) -> SourceHealth:
    (stream,) = GYRO.streams
    figures = replace(FIGURES, **changes)  # type: ignore[arg-type] # names and values are below
    return replace(GYRO, streams=(replace(stream, statistics=figures),))


@pytest.mark.parametrize(
    ("source", "level", "text"),
    [
        (GYRO, Level.OK, "recording"),
        (WHEELS, Level.ERROR, "can0: network is down"),
        (replace(GYRO, state="hung"), Level.ERROR, "does not return"),
        (replace(GYRO, state="ended"), Level.STALE, "ended"),
        (replace(GYRO, losses=2), Level.WARN, "lost 2 times"),
        (replace(GYRO, queue=replace(QUEUE, dropped=7)), Level.WARN, "7 samples dropped"),
        (replace(GYRO, warning="no real-time priority"), Level.WARN, "no real-time"),
        (with_figures(rate_hz=320.0), Level.WARN, "/gyro: 320.0 Hz instead of 400.0"),
        (with_figures(rate_hz=None), Level.WARN, "/gyro: 0.0 Hz instead of 400.0"),
        (with_figures(gaps=2, gap_s=0.75), Level.WARN, "/gyro: 2 gaps, 0.750 s in all"),
        (with_figures(missed=3), Level.WARN, "3 samples missing before"),
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
    assert "3 checksum errors; mended: 2 failed transfers" in lines_of(snapshot)[1]
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


def test_lines_say_who_is_in_trouble() -> None:
    snapshot = replace(SNAPSHOT, sources=(GYRO, WHEELS), warnings=("disk slow",))
    assert lines_of(snapshot) == [
        "10 s, 5.0 MB, 100000 MB free",
        "OK gyro: 399.8/400 Hz recording",
        "ERROR wheels: can0: network is down",
        "WARN disk slow",
    ]


def test_the_end_says_what_every_source_has_given() -> None:
    source = replace(with_figures(gaps=2, missed=3), losses=1, queue=replace(QUEUE, dropped=7))
    assert totals_of(replace(SNAPSHOT, sources=(source, WHEELS))) == [
        "  gyro: 4000 samples, 2 gaps, 3 missing, 7 dropped, lost 1 times",
        "  wheels: nothing; can0: network is down",
    ]


def test_the_rate_of_a_devices_clock_is_shown_where_it_is_known() -> None:
    snapshot = replace(SNAPSHOT, sources=(replace(GYRO, clock_skew_ppm=-40.04),))
    line = "OK gyro: 399.8/400 Hz recording, clock -40.0 ppm"
    assert lines_of(snapshot)[1] == line
    assert diagnostics_of(snapshot).statuses[1].values["clock_skew_ppm"] == "-40.04"


def test_the_table_shows_every_stream_and_takes_names_literally() -> None:
    (stream,) = GYRO.streams
    unknown = replace(FIGURES, rate_hz=None, nominal_rate_hz=None, jitter_s=None)
    both = replace(
        GYRO,
        name="[bold]gyro",
        streams=(stream, StreamHealth("/gyro/temperature", unknown, 0, 0)),
    )
    out = io.StringIO()
    table = table_of(replace(SNAPSHOT, sources=(both, WHEELS), warnings=("disk slow",)))
    Console(file=out, width=160).print(table)
    text = out.getvalue()
    for part in ("[bold]gyro", "/gyro/temperature", "0.21 ms", "network is down", "disk slow"):
        assert part in text
