"""The host's clocks: the one place that reads them, and what they do behind our backs.

Everything is stamped with CLOCK_MONOTONIC, which no time server moves. The log time of a
recording is that clock plus an offset to the epoch, read once at the start and frozen, so that
neither a step of the real-time clock nor a suspend breaks the order of a recording. What the
real-time clock did meanwhile is told by triples and events (/clock).

Linux slews CLOCK_MONOTONIC and CLOCK_REALTIME alike, and CLOCK_BOOTTIME is CLOCK_MONOTONIC plus
the time spent suspended (clock_gettime(2)). So real time minus boot time moves only when somebody
sets the clock, and boot time minus monotonic time only by a suspend: the two are told apart
exactly, whatever the clock's rate.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from acquisition.clocks.clock_sample import ClockSample

EventKind = Literal["real_time_step", "suspend", "device_step", "device_restart"]

# Smaller changes are the scatter of reading four clocks one after the other.
EVENT_THRESHOLD_NS = 10_000_000
_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
_TRIES = 3


def read_boot_id() -> str:
    """Return the identity of this boot; "" where the system has none."""
    try:
        return _BOOT_ID.read_text().strip()
    except OSError:
        return ""


def _raw_ns() -> int:
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)


def _boot_ns() -> int:
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


@dataclass(frozen=True, slots=True)
class SystemClocks:
    """The clocks of the operating system, as functions; a test puts its own in their place.

    Attributes:
        monotonic_ns: CLOCK_MONOTONIC, in which everything is stamped.
        raw_ns: CLOCK_MONOTONIC_RAW, the oscillator that no time server corrects.
        real_ns: CLOCK_REALTIME, nanoseconds since 1970-01-01 UTC.
        boot_ns: CLOCK_BOOTTIME, the monotonic clock that goes on during a suspend.
        boot_id: identity of the boot, from which the other clocks count.
    """

    monotonic_ns: Callable[[], int] = time.monotonic_ns
    raw_ns: Callable[[], int] = _raw_ns
    real_ns: Callable[[], int] = time.time_ns
    boot_ns: Callable[[], int] = _boot_ns
    boot_id: Callable[[], str] = read_boot_id


@dataclass(frozen=True, slots=True)
class ClockReading:
    """All clocks at one moment.

    Attributes:
        monotonic_ns: CLOCK_MONOTONIC.
        raw_ns: CLOCK_MONOTONIC_RAW.
        real_ns: CLOCK_REALTIME.
        boot_ns: CLOCK_BOOTTIME.
        width_ns: how long the reading took; the clocks agree to that much.
    """

    monotonic_ns: int
    raw_ns: int
    real_ns: int
    boot_ns: int
    width_ns: int


@dataclass(frozen=True, slots=True)
class ClockEvent:
    """A clock did what a clock should not do.

    Attributes:
        kind: "real_time_step": somebody set the real-time clock. "suspend": the host slept.
            "device_step": a device's clock jumped. "device_restart": it began anew.
        monotonic_ns: when it was noticed.
        amount_ns: by how much: the step of the clock, forward positive, or the length of the
            sleep; 0 where nobody can tell.
    """

    kind: EventKind
    monotonic_ns: int
    amount_ns: int

    def describe(self) -> str:
        """Return one line."""
        return f"{self.kind.replace('_', ' ')} of {self.amount_ns * 1e-9:+.3f} s"


class HostClock:
    """Stamps, log times, and a watch over the real-time clock.

    Attributes:
        offset_ns: log time minus CLOCK_MONOTONIC, frozen when this object was made.
        boot_id: identity of the boot.
    """

    def __init__(self, clocks: SystemClocks | None = None) -> None:
        """Freeze the offset.

        Args:
            clocks: the clocks to read; those of the operating system by default.
        """
        self._clocks = clocks or SystemClocks()
        self.monotonic_ns = self._clocks.monotonic_ns
        self.boot_id = self._clocks.boot_id()
        self._last = self.read()
        self.offset_ns = self._last.real_ns - self._last.monotonic_ns

    def now_ns(self) -> int:
        """Return CLOCK_MONOTONIC."""
        return self.monotonic_ns()

    def log_time_ns(self, monotonic_ns: int) -> int:
        """Return the log time of a stamp: nanoseconds since the epoch, as known at the start."""
        return monotonic_ns + self.offset_ns

    def read(self) -> ClockReading:
        """Return all clocks at one moment: the closest together of a few readings."""
        return min((self._read_once() for _ in range(_TRIES)), key=lambda r: r.width_ns)

    def _read_once(self) -> ClockReading:
        clocks = self._clocks
        before_ns = clocks.monotonic_ns()
        raw_ns, real_ns, boot_ns = clocks.raw_ns(), clocks.real_ns(), clocks.boot_ns()
        width_ns = clocks.monotonic_ns() - before_ns
        return ClockReading(before_ns + width_ns // 2, raw_ns, real_ns, boot_ns, width_ns)

    def watch(self) -> tuple[ClockReading, list[ClockEvent]]:
        """Return all clocks, and what happened to them since the last call or the start."""
        last, now = self._last, self.read()
        self._last = now
        slept_ns = (now.boot_ns - now.monotonic_ns) - (last.boot_ns - last.monotonic_ns)
        stepped_ns = (now.real_ns - now.boot_ns) - (last.real_ns - last.boot_ns)
        # A reading that was interrupted each time tells nothing finer than its width.
        threshold_ns = EVENT_THRESHOLD_NS + now.width_ns + last.width_ns
        found: list[tuple[EventKind, int]] = [("suspend", slept_ns), ("real_time_step", stepped_ns)]
        return now, [
            ClockEvent(kind, now.monotonic_ns, amount_ns)
            for kind, amount_ns in found
            if abs(amount_ns) > threshold_ns
        ]

    def samples(self, sequence: int, source: str = "host") -> list[ClockSample]:
        """Return what /clock says about the host now: one sample, and one more for each event.

        Args:
            sequence: of the first; the others count on.
            source: the name under which the host appears.
        """
        reading, events = self.watch()
        happened = [("", 0), *((event.kind, event.amount_ns) for event in events)]
        return [
            ClockSample(
                t_ns=reading.monotonic_ns,
                source=source,
                host_monotonic_ns=reading.monotonic_ns,
                host_raw_ns=reading.raw_ns,
                host_real_ns=reading.real_ns,
                boot_id=self.boot_id,
                offset_ns=self.offset_ns,
                event=kind,
                event_ns=amount_ns,
                sequence=sequence + number,
            )
            for number, (kind, amount_ns) in enumerate(happened)
        ]
