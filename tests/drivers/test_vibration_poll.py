"""The conversation with a polled device, on a wire and a clock that the test holds."""

from __future__ import annotations

import pytest

from drivers.errors import DriverError
from drivers.vibration.poll import PollCounters, Poller
from drivers.vibration.profile_tables import Poll
from tests.fakes.fake_time import FakeTime

_MS = 1_000_000
_REQUEST = bytes.fromhex("50 03 00 30 00 17 08 4A")
_EXCEPTION = bytes.fromhex("50 83 02 91 20")


class _Bench:
    """A wire, a clock and a poller that asks every 100 ms and waits 20 ms for a reply."""

    def __init__(self, retries: int = 2) -> None:
        self.time = FakeTime()
        self.log: list[str] = []
        poll = Poll(request=_REQUEST, reply_within_s=0.02, retries=retries, modbus=True)
        self.poller = Poller("/dev/x", poll, 100 * _MS, self.time, self._sleep)

    def _sleep(self, seconds: float) -> None:
        self.log.append(f"sleep {seconds * 1000:g} ms")
        self.time.sleep(seconds)

    def write(self, data: bytes) -> None:
        assert data == _REQUEST
        self.log.append("request")

    def discard_input(self) -> None:
        self.log.append("discard")

    def ask(self, within_ms: int = 1000) -> float:
        return self.poller.ask(self, self.time() + within_ms * _MS)

    def hear(self, data: bytes, *, after_ms: int = 5, answered: bool = False) -> None:
        self.time.advance(after_ms / 1000)
        self.poller.hear(data, answered=answered)


def test_requests_keep_the_beat() -> None:
    bench = _Bench()
    for after_ms in (5, 12, 8):
        assert bench.ask() == 0.02
        bench.hear(b"...", after_ms=after_ms, answered=True)
    assert bench.log == [
        *("discard", "request", "sleep 95 ms"),
        *("discard", "request", "sleep 88 ms"),
        *("discard", "request"),
    ]
    assert bench.poller.counters == PollCounters(requests=3)


def test_beats_that_were_missed_are_not_caught_up() -> None:
    bench = _Bench()
    bench.ask()
    bench.hear(b"...", answered=True)
    bench.time.advance(0.73)
    bench.ask()
    bench.hear(b"...", answered=True)
    bench.ask()
    assert bench.log[-3:] == ["sleep 95 ms", "discard", "request"]


def test_the_deadline_ends_the_wait_for_the_beat() -> None:
    bench = _Bench()
    bench.ask()
    bench.hear(b"...", answered=True)
    assert bench.ask(within_ms=30) == 0.0
    assert bench.log[2:] == ["sleep 30 ms"]
    assert bench.ask(within_ms=100) == 0.02
    assert bench.log[3:] == ["sleep 65 ms", "discard", "request"]


def test_the_wait_for_a_reply_may_span_two_reads() -> None:
    bench = _Bench()
    assert bench.ask(within_ms=8) == 0.008
    bench.hear(b"\x50\x03", after_ms=8)
    assert bench.ask(within_ms=100) == 0.012
    bench.hear(b"\x2e", answered=True)
    assert bench.log == ["discard", "request"]


def test_silence_and_damage_are_repeated_at_once_and_counted() -> None:
    bench = _Bench()
    bench.ask()
    bench.hear(b"", after_ms=20)
    bench.ask()
    bench.hear(b"\x50\x03\x2e\x00", after_ms=20)
    bench.ask()
    bench.hear(b"...", answered=True)
    assert "sleep" not in " ".join(bench.log)
    assert bench.poller.counters == PollCounters(requests=3, silent=1, damaged=1)


def test_an_exception_ends_the_wait_and_the_last_cause_is_named() -> None:
    bench = _Bench(retries=2)
    for _ in range(2):
        bench.ask()
        bench.hear(_EXCEPTION)
    bench.ask()
    with pytest.raises(DriverError, match=r"/dev/x: 3 requests .* exception 2 \(illegal register"):
        bench.hear(_EXCEPTION)
    assert bench.poller.counters == PollCounters(requests=3, exceptions=3)


def test_after_the_error_counting_begins_again() -> None:
    bench = _Bench(retries=0)
    for _ in range(2):
        bench.ask()
        with pytest.raises(DriverError, match=r"1 requests .* nothing came"):
            bench.hear(b"", after_ms=20)
    assert bench.poller.counters == PollCounters(requests=2, silent=2)
