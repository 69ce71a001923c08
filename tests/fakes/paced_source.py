"""A source that gives samples at a rate, and knows how late each was stamped.

It fakes a device that blocks in `read` until its next sample is due. It does not fake a bus, a
device clock or samples that arrive in bursts.
"""

from __future__ import annotations

import time
from array import array
from collections.abc import Callable, Sequence

from drivers.faults import NO_FAULTS, Faults
from drivers.samples import Sample
from drivers.source import SourceInfo, TickCounter

_BIN_NS = 10_000
_BINS = 20_000  # up to 0.2 s; later than that counts as that


class PacedSource:
    """Implements `drivers.source.Source`; never ends. Keeps a histogram, so memory stays flat."""

    def __init__(
        self,
        name: str,
        rate_hz: float,
        produces: type[Sample],
        make: Callable[[int, int], Sample],
        *,
        counter: TickCounter | None = None,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], object] = time.sleep,
    ) -> None:
        """Give `make(sequence, t_ns)` at that rate."""
        self.name = name
        self.produces = produces
        self.given = 0
        self._rate_hz = rate_hz
        self._make = make
        self._counter = counter
        self._clock_ns = clock_ns
        self._sleep = sleep
        self._began_ns = 0
        self._late = array("Q", bytes(8 * _BINS))

    @property
    def faults(self) -> Faults:
        """None."""
        return NO_FAULTS

    def open(self) -> SourceInfo:
        """Start over."""
        self._began_ns = 0
        self.given = 0
        self._late = array("Q", bytes(8 * _BINS))
        rates = {self.produces: self._rate_hz}
        kinds = (self.produces,)
        return SourceInfo(self.name, "paced", "", kinds, "monotonic", {}, rates, self._counter)

    def read(self, timeout_s: float) -> Sequence[Sample]:
        """Wait for the next sample, or for the timeout."""
        now_ns = self._clock_ns()
        self._began_ns = self._began_ns or now_ns
        due_ns = self._began_ns + int(self.given * 1e9 / self._rate_hz)
        wait_s = (due_ns - now_ns) * 1e-9
        if wait_s > timeout_s:
            self._sleep(timeout_s)
            return ()
        if wait_s > 0.0:
            self._sleep(wait_s)
        t_ns = self._clock_ns()
        self._late[min((t_ns - due_ns) // _BIN_NS, _BINS - 1)] += 1
        sample = self._make(self.given, t_ns)
        self.given += 1
        return (sample,)

    def close(self) -> None:
        """Nothing is open."""

    def lateness_ms(self, percentile: float) -> float:
        """Return how late stamps were: upper edge of the bin of that percentile, ms."""
        wanted = percentile / 100.0 * sum(self._late)
        seen = 0
        for number, samples in enumerate(self._late):
            seen += samples
            if seen >= wanted:
                return (number + 1) * _BIN_NS * 1e-6
        return _BINS * _BIN_NS * 1e-6
