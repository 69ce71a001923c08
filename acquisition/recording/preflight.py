"""Before recording: open every source, all at once, and say in one report what is not there."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from acquisition.clocks.host_clock import HostClock
from acquisition.recording.source_worker import SourceWorker, WorkerSettings
from drivers.source import Source, SourceInfo

PREFLIGHT_TIMEOUT_S = 10.0
STOP_TIMEOUT_S = 2.0


@dataclass(frozen=True, slots=True)
class SourceCheck:
    """One source: what answered, or why nothing did.

    Attributes:
        name: the source's name.
        info: what it said; None when it could not be opened.
        error: why; "" when it was opened.
    """

    name: str
    info: SourceInfo | None
    error: str


@dataclass(frozen=True, slots=True)
class PreflightReport:
    """All sources, in the order in which they were given."""

    checks: tuple[SourceCheck, ...]

    @property
    def missing(self) -> tuple[SourceCheck, ...]:
        """Those that could not be opened."""
        return tuple(check for check in self.checks if check.info is None)

    def as_json(self) -> dict[str, object]:
        """Return each source's name, model, serial number and error as JSON values."""
        return {
            "sources": [
                {
                    "name": check.name,
                    "model": check.info.model if check.info else None,
                    "serial": check.info.serial if check.info else None,
                    "error": check.error,
                }
                for check in self.checks
            ]
        }

    def describe(self) -> list[str]:
        """Return one line for each source."""
        return [_line(check) for check in self.checks]


def _line(check: SourceCheck) -> str:
    if check.info is None:
        return f"missing {check.error}"
    serial = f" {check.info.serial}" if check.info.serial else ""
    return f"ready {check.name}: {check.info.model}{serial}"


def try_all(workers: Sequence[SourceWorker], timeout_s: float) -> PreflightReport:
    """Start the workers and wait until each has tried once to open its source."""
    for worker in workers:
        worker.start()
    deadline_s = time.monotonic() + timeout_s
    return PreflightReport(tuple(_check(worker, deadline_s, timeout_s) for worker in workers))


def _check(worker: SourceWorker, deadline_s: float, timeout_s: float) -> SourceCheck:
    if not worker.wait_until_tried(max(0.0, deadline_s - time.monotonic())):
        return SourceCheck(worker.name, None, f"{worker.name}: no answer within {timeout_s:g} s")
    error = worker.error
    return SourceCheck(worker.name, None if error else worker.info, error)


def preflight(sources: Sequence[Source], timeout_s: float = PREFLIGHT_TIMEOUT_S) -> PreflightReport:
    """Open every source, report, and close them again; nothing is recorded."""
    clock = HostClock()
    workers = [SourceWorker(source, clock, WorkerSettings()) for source in sources]
    try:
        return try_all(workers, timeout_s)
    finally:
        stop_all(workers)


def stop_all(workers: Sequence[SourceWorker], timeout_s: float = STOP_TIMEOUT_S) -> list[str]:
    """Stop the workers together; return the names of those that hang in their driver."""
    for worker in workers:
        worker.stop()
    deadline_s = time.monotonic() + timeout_s
    return [w.name for w in workers if not w.join(max(0.0, deadline_s - time.monotonic()))]
