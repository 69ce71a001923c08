"""What ends a command from outside, and what does not."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest

from acquisition.commands.signals import Stop, stopped_by_signals

ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.fixture
def ignored_hangup() -> Iterator[None]:
    """Ignore SIGHUP, as nohup does."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize("number", ENDS)
def test_each_signal_that_ends_stops_and_is_given_back(number: signal.Signals) -> None:
    before = [signal.getsignal(end) for end in ENDS]
    with stopped_by_signals(lambda: None) as stop:
        assert not stop.is_set()
        signal.raise_signal(number)
        signal.raise_signal(number)
        assert stop.is_set()
    assert [signal.getsignal(end) for end in ENDS] == before


@pytest.mark.usefixtures("ignored_hangup")
def test_what_is_ignored_stays_so() -> None:
    with stopped_by_signals(lambda: None) as stop:
        signal.raise_signal(signal.SIGHUP)
        assert not stop.is_set()


def test_the_ring_is_triggered_and_goes_on() -> None:
    triggered: list[None] = []
    with stopped_by_signals(lambda: triggered.append(None)) as stop:
        signal.raise_signal(signal.SIGUSR1)
        assert not stop.is_set()
    assert len(triggered) == 1


def test_time_is_up_from_when_it_was_set(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 100.0
    monkeypatch.setattr("acquisition.commands.signals.time.monotonic", lambda: now_s)
    stop = Stop()
    now_s = 500.0
    stop.after(10.0)
    now_s = 509.0
    assert not stop.is_set()
    now_s = 510.0
    assert stop.is_set()
