"""The conversation with a device that speaks only when asked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from drivers.errors import DriverError
from drivers.vibration.modbus_replies import refusal
from drivers.vibration.profile_tables import Poll


class Wire(Protocol):
    """What the conversation needs of a serial port."""

    def write(self, data: bytes) -> None:
        """Send bytes."""

    def discard_input(self) -> None:
        """Throw away what has arrived and was not read."""


@dataclass(frozen=True, slots=True)
class PollCounters:
    """How the requests since `open` fared.

    Attributes:
        requests: requests sent.
        silent: requests without a single byte in reply.
        damaged: requests answered by bytes that hold no frame.
        exceptions: requests refused with a Modbus exception.
        wrong_slave: requests answered by another slave.
    """

    requests: int = 0
    silent: int = 0
    damaged: int = 0
    exceptions: int = 0
    wrong_slave: int = 0


class Poller:
    """Sends a request when it is due, waits for the reply, and asks again when none comes.

    One request is under way at a time; the wait for its reply may span several `read` calls.
    """

    def __init__(
        self,
        port: str,
        poll: Poll,
        interval_ns: int,
        clock_ns: Callable[[], int],
        sleep: Callable[[float], None],
    ) -> None:
        self._port = port
        self._poll = poll
        self._interval_ns = interval_ns
        self._clock_ns = clock_ns
        self._sleep = sleep
        self._counts: Counter[str] = Counter()
        self._due_ns = 0
        self._reply_until_ns: int | None = None  # None: no request is under way
        self._heard = b""
        self._failures = 0

    @property
    def counters(self) -> PollCounters:
        """The counters so far."""
        return PollCounters(**self._counts)

    @property
    def overdue(self) -> bool:
        """Whether a request is under way whose reply should have been whole by now."""
        return self._reply_until_ns is not None and self._clock_ns() >= self._reply_until_ns

    def ask(self, wire: Wire, deadline_ns: int) -> float:
        """Send the request when it is due, and return how long to listen for its reply, s.

        When the deadline comes before the request is due, sleep until the deadline and return 0.
        """
        if self._reply_until_ns is None:
            wait_ns = min(self._due_ns, deadline_ns) - self._clock_ns()
            if wait_ns > 0:
                self._sleep(wait_ns / 1e9)
            if self._due_ns > deadline_ns:
                return 0.0
            self._reply_until_ns = self._send(wire)
        return max(0, min(self._reply_until_ns, deadline_ns) - self._clock_ns()) / 1e9

    def hear(self, data: bytes, *, answered: bool) -> None:
        """Take note of what came, and whether it completed a frame.

        Raises:
            DriverError: the request and all its repetitions failed.
        """
        if answered:
            self._reply_until_ns, self._failures = None, 0
        if self._reply_until_ns is None:
            return
        self._heard += data
        other = refusal(self._poll.request, self._heard) if self._poll.modbus else None
        if other is not None:
            self._fail("exceptions" if other.kind == "exception" else "wrong_slave", other.text)
        elif self.overdue:
            if self._heard:
                self._fail("damaged", f"{len(self._heard)} bytes without a frame came")
            else:
                self._fail("silent", "nothing came")

    def _send(self, wire: Wire) -> int:
        """Send the request; return until when to wait for its reply."""
        wire.discard_input()  # a reply that came too late must not answer this request
        wire.write(self._poll.request)
        now_ns = self._clock_ns()
        self._counts["requests"] += 1
        self._heard = b""
        if now_ns - self._due_ns > self._interval_ns:
            self._due_ns = now_ns  # keep the beat, but do not catch up on what was missed
        self._due_ns += self._interval_ns
        return now_ns + round(self._poll.reply_within_s * 1e9)

    def _fail(self, counter: str, what: str) -> None:
        self._counts[counter] += 1
        self._reply_until_ns = None
        self._due_ns = 0  # ask again at once
        self._failures += 1
        if self._failures > self._poll.retries:
            requests, self._failures = self._failures, 0
            raise DriverError(
                f"{self._port}: {requests} requests without an answer, last: {what}; expected a "
                f"frame within {self._poll.reply_within_s} s; "
                "check wiring, speed and the device's address"
            )
