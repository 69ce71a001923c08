"""The host's clocks: log times that nothing disturbs, and events that tell what tried to."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.clocks import host_clock as clock_module
from acquisition.clocks.clock_sample import ClockSample
from acquisition.clocks.host_clock import ClockEvent, HostClock, SystemClocks, read_boot_id
from tests.fakes.clocks import FakeHost, S
from tests.fakes.recordings import START_NS, clock_sample, pose, reader_of, recording


def test_log_time_is_monotonic_time_plus_the_offset_at_the_start() -> None:
    host = FakeHost()
    clock = HostClock(host.clocks)
    assert clock.offset_ns == host.real_offset_ns
    assert clock.log_time_ns(clock.monotonic_ns()) == 1_700_000_005 * S
    assert clock.boot_id == "boot-1"


@pytest.mark.parametrize("step_s", [3600, -3600, 0.02, -0.02])
def test_a_step_of_the_real_time_clock_moves_no_log_time(step_s: float) -> None:
    host = FakeHost()
    clock = HostClock(host.clocks)
    before_ns = clock.log_time_ns(clock.monotonic_ns())
    host.monotonic_ns += S
    host.real_offset_ns += round(step_s * S)
    reading, events = clock.watch()
    assert clock.log_time_ns(clock.monotonic_ns()) == before_ns + S
    assert events == [ClockEvent("real_time_step", 6 * S, round(step_s * S))]
    assert reading.real_ns == 1_700_000_006 * S + round(step_s * S)
    assert clock.watch()[1] == []


def test_a_suspend_is_told_from_a_step() -> None:
    host = FakeHost()
    clock = HostClock(host.clocks)
    host.suspend(90 * S)
    _, events = clock.watch()
    assert events == [ClockEvent("suspend", 5 * S, 90 * S)]
    assert events[0].describe() == "suspend of +90.000 s"
    host.suspend(60 * S)
    host.real_offset_ns -= 3600 * S
    assert [(e.kind, e.amount_ns) for e in clock.watch()[1]] == [
        ("suspend", 60 * S),
        ("real_time_step", -3600 * S),
    ]


@given(st.lists(st.tuples(st.integers(0, 10**12), st.integers(-(10**13), 10**13)), max_size=20))
def test_log_times_never_run_backwards_and_every_step_is_told(
    moves: list[tuple[int, int]],
) -> None:
    host = FakeHost()
    clock = HostClock(host.clocks)
    last_ns = 0
    for passed_ns, step_ns in moves:
        host.monotonic_ns += passed_ns
        host.real_offset_ns += step_ns
        now_ns = clock.log_time_ns(clock.monotonic_ns())
        assert now_ns >= last_ns
        last_ns = now_ns
        told = [event.amount_ns for event in clock.watch()[1]]
        assert told == ([step_ns] if abs(step_ns) > clock_module.EVENT_THRESHOLD_NS else [])


def test_an_interrupted_reading_is_no_event() -> None:
    host = FakeHost()
    clock = HostClock(host.clocks)
    host.reading_takes_ns = 40_000_000
    reading, events = clock.watch()
    assert reading.width_ns == 40_000_000
    assert events == []


def test_samples_tell_the_triple_and_the_events() -> None:
    host = FakeHost()
    clock = HostClock(host.clocks)
    host.suspend(2 * S)
    plain, suspended = clock.samples(sequence=7)
    assert plain == ClockSample(
        t_ns=5 * S,
        source="host",
        host_monotonic_ns=5 * S,
        host_raw_ns=5 * S + 11,
        host_real_ns=1_700_000_007 * S,
        boot_id="boot-1",
        offset_ns=1_700_000_000 * S,
        sequence=7,
    )
    assert (suspended.event, suspended.event_ns, suspended.sequence) == ("suspend", 2 * S, 8)


def test_the_systems_clocks_agree_with_each_other() -> None:
    clock = HostClock(SystemClocks())
    reading, events = clock.watch()
    assert events == []
    assert abs(reading.monotonic_ns - time.monotonic_ns()) < 10 * S
    assert abs(reading.real_ns - time.time_ns()) < 10 * S
    assert reading.boot_ns >= reading.monotonic_ns - S
    assert reading.raw_ns > 0
    assert abs(clock.log_time_ns(reading.monotonic_ns) - reading.real_ns) < S


def test_a_system_without_boot_id_has_an_empty_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clock_module, "_BOOT_ID", tmp_path / "none")
    assert read_boot_id() == ""
    (tmp_path / "some").write_text("1234\n")
    monkeypatch.setattr(clock_module, "_BOOT_ID", tmp_path / "some")
    assert read_boot_id() == "1234"


def test_clock_samples_are_recorded_beside_every_source() -> None:
    clocks = [clock_sample(0), clock_sample(1, START_NS + 5)]
    reader = reader_of(recording([clocks[0], pose(0), clocks[1]]))
    said = [message.sample for message in reader if message.topic == "/clock"]
    assert said == clocks
    assert reader.report.messages["/clock"] == 2
