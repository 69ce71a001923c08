"""The clock that the recorder needs; `acquisition.clocks.host_clock.HostClock` is one."""

from __future__ import annotations

from typing import Protocol

from acquisition.clocks.clock_sample import ClockSample


class Clock(Protocol):
    """Monotonic time for order, and its translation into the time that a recording tells."""

    def now_ns(self) -> int:
        """Return CLOCK_MONOTONIC."""

    def log_time_ns(self, monotonic_ns: int, /) -> int:
        """Return nanoseconds since 1970 for a monotonic time; rises when that rises."""

    def samples(self, sequence: int) -> list[ClockSample]:
        """Return what /clock says now, numbered from `sequence`, in monotonic time."""
