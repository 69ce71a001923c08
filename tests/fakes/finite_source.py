"""A source that gives prepared samples, two at a time, with empty reads between; no device."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.errors import DriverError, EndOfSource
from drivers.faults import NO_FAULTS, Faults
from drivers.samples import Sample
from drivers.source import SourceInfo
from tests.fakes.recordings import SOURCE


class FiniteSource:
    """Implements `drivers.source.Source`; fails after `fails_after` samples when that is given."""

    name = SOURCE.name

    def __init__(self, content: Sequence[Sample], fails_after: int | None = None) -> None:
        self._content = list(content)
        self._fails_after = fails_after
        self._reads = 0
        self.opened = 0
        self.closed = 0

    @property
    def faults(self) -> Faults:
        """None."""
        return NO_FAULTS

    def open(self) -> SourceInfo:
        """Say what comes."""
        self.opened += 1
        return SOURCE

    def read(self, timeout_s: float) -> Sequence[Sample]:
        """Give two samples on every second read."""
        self._reads += 1
        if self._reads % 2:
            return ()
        start = self._reads - 2
        if self._fails_after is not None and start >= self._fails_after:
            raise DriverError(f"{self.name}: unplugged")
        if start >= len(self._content):
            raise EndOfSource
        return self._content[start : start + 2]

    def close(self) -> None:
        """Count."""
        self.closed += 1
