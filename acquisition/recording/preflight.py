"""Before recording: open every source, all at once, and say in one report what is not there."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from acquisition.clocks.host_clock import HostClock
from acquisition.recording.source_worker import SourceWorker, WorkerSettings
from drivers.source import Source, SourceInfo

PREFLIGHT_TIMEOUT_S = 10.0
STOP_TIMEOUT_S = 2.0
# A stop is noticed within this time.
STOP_SEEN_WITHIN_S = 0.05


class StopFlag(Protocol):
    """Tells whether it is to be stopped, such as an `Event`.

    It is asked, not waited for: `Event.wait` holds the event's lock for moments, and a signal
    handler that sets the event in such a moment, in the same thread, waits for that lock for ever.
    """

    def is_set(self) -> bool:
        """Tell whether to stop."""


def pause(stop: StopFlag, duration_s: float) -> bool:
    """Sleep so long, but not beyond a stop; true when there was one."""
    end_s = time.monotonic() + duration_s
    while not stop.is_set():
        left_s = end_s - time.monotonic()
        if left_s <= 0.0:
            return False
        time.sleep(min(left_s, STOP_SEEN_WITHIN_S))
    return True


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


def try_all(
    workers: Sequence[SourceWorker], timeout_s: float, stop: StopFlag | None = None
) -> PreflightReport:
    """Start the workers; wait until each has tried once to open its source, or for `stop`."""
    for worker in workers:
        worker.start()
    deadline_s = time.monotonic() + timeout_s
    for worker in workers:
        _wait_for(worker, deadline_s, stop)
    return PreflightReport(tuple(_check(worker, timeout_s) for worker in workers))


def _wait_for(worker: SourceWorker, deadline_s: float, stop: StopFlag | None) -> None:
    left_s = deadline_s - time.monotonic()
    while not worker.wait_until_tried(min(max(0.0, left_s), STOP_SEEN_WITHIN_S)):
        left_s = deadline_s - time.monotonic()
        if left_s <= 0.0 or (stop is not None and stop.is_set()):
            return


def _check(worker: SourceWorker, timeout_s: float) -> SourceCheck:
    if not worker.wait_until_tried(0.0):
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
