"""The clock that the recorder needs."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Monotonic time for order, and its translation into the time that a recording tells."""

    def now_ns(self) -> int:
        """Return CLOCK_MONOTONIC."""

    def log_time_ns(self, mono_ns: int) -> int:
        """Return nanoseconds since 1970 for a monotonic time; rises when that rises."""


class FrozenOffsetClock:
    """Monotonic time plus the offset to UTC that was found once, at construction.

    Later steps of the wall clock do not reach the recording.
    """

    def __init__(self) -> None:
        self._offset_ns = time.time_ns() - time.monotonic_ns()

    def now_ns(self) -> int:
        """Return CLOCK_MONOTONIC."""
        return time.monotonic_ns()

    def log_time_ns(self, mono_ns: int) -> int:
        """Return nanoseconds since 1970."""
        return mono_ns + self._offset_ns
