"""All sources into one stream: nothing lost unnoticed, and no source at the mercy of another.

Each source has a thread that reads, stamps and puts samples into a bounded queue. The thread
that calls `run` takes what is there every flush interval, puts it in order, writes and flushes
it. It alone compresses and writes, so a slow disk delays no stamp; when the queues have no more
room, samples are dropped and counted.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace

from acquisition.clocks.clock_follower import DEFAULT_TUNING
from acquisition.clocks.clock_sample import ClockSample
from acquisition.clocks.host_clock import HostClock
from acquisition.clocks.recorder_clock import Clock
from acquisition.errors import OutputEndedError, RecorderError, StreamError
from acquisition.health.diagnostics import Diagnostics
from acquisition.health.monitor import HealthMonitor
from acquisition.health.snapshot import HealthSnapshot, diagnostics_of, statistics_record
from acquisition.recording.clock_records import ClockRecords
from acquisition.recording.intake import Stamped
from acquisition.recording.lane import Lane
from acquisition.recording.output import RecordingOutput
from acquisition.recording.plan import Outcome, RecordingPlan, RecordingResult
from acquisition.recording.preflight import (
    PreflightReport,
    StopFlag,
    pause,
    stop_all,
    try_all,
)
from acquisition.recording.source_worker import SourceWorker
from acquisition.recording.thread_priority import short_switch_interval
from acquisition.stream.split_writer import Head
from drivers.source import Source, SourceInfo, TimeBase


class Recorder:
    """Records once: `run` until it is told to stop.

    Attributes:
        snapshot: the latest health, replaced once a second; any thread may read it. None before
            recording began.
    """

    def __init__(
        self,
        sources: Sequence[Source],
        output: RecordingOutput,
        plan: RecordingPlan | None = None,
        clock: Clock | None = None,
    ) -> None:
        """Touch nothing yet.

        Raises:
            RecorderError: no sources, or two of the same name.
        """
        names = [source.name for source in sources]
        if not names or len(set(names)) < len(names):
            raise RecorderError(
                f"sources are {', '.join(names) or 'none'}; expected at least one, and a name of "
                "its own for each"
            )
        self.snapshot: HealthSnapshot | None = None
        self._plan = plan or RecordingPlan()
        self._clock = clock or HostClock()
        self._output = output
        self._workers = [SourceWorker(s, self._clock, self._plan.worker) for s in sources]
        self._lanes = [
            Lane(
                worker,
                self._clock,
                self._plan.rates_hz,
                self._plan.clocks.get(worker.name, DEFAULT_TUNING),
            )
            for worker in self._workers
        ]
        self._monitor = HealthMonitor(self._lanes, self._output, self._clock)
        self._clock_records = ClockRecords(self._lanes, self._clock)
        self._time_base: TimeBase = "monotonic"
        self._newest_ns: int | None = None
        self._handed = 0
        self._hanging: tuple[str, ...] = ()
        self._stopped = False
        self._report: PreflightReport | None = None

    def preflight(self, stop: StopFlag | None = None) -> PreflightReport:
        """Open every source, all at once; they stay open for `run`. The first call does it.

        Args:
            stop: ends the wait for those that have not answered.
        """
        if self._report is None:
            self._report = try_all(self._workers, self._plan.preflight_timeout_s, stop)
        return self._report

    def close(self) -> None:
        """Close the sources; needed only when `run` is not called after `preflight`."""
        self._stop_workers()

    def run(
        self,
        stop: StopFlag,
        heartbeat: Callable[[HealthSnapshot], object] | None = None,
    ) -> RecordingResult:
        """Record until `stop` is set, every source has ended, or the output fails for good.

        Args:
            stop: such as an `Event`, set in any thread or in a signal handler; set before
                recording began, it leaves no file.
            heartbeat: called once a second in the recording thread; must neither block nor raise,
                but for an OSError: that a display is gone is no reason to record nothing.

        Raises:
            RecorderError: sources are missing that are required, or all of them.
            StreamError: the recording cannot be begun.
        """
        try:
            report = self.preflight(stop)
            if stop.is_set():
                return self._not_begun()
            self._require_sources(report)
            self._output.start(self._head())
            with short_switch_interval():
                outcome, message = self._record(stop, heartbeat or (lambda _: None))
            return self._finish(outcome, message)
        except BaseException:
            with suppress(StreamError):  # what went wrong first is what the caller must know
                self._output.close()
            raise
        finally:
            self._stop_workers()

    def _stop_workers(self) -> None:
        """Stop all; the second call does nothing."""
        if not self._stopped:
            self._stopped = True
            self._hanging = tuple(stop_all(self._workers, self._plan.stop_timeout_s))

    def _require_sources(self, report: PreflightReport) -> None:
        missing = report.missing
        if missing and (self._plan.require_all or len(missing) == len(report.checks)):
            reasons = "; ".join(check.error for check in missing)
            raise RecorderError(
                f"{len(missing)} of {len(report.checks)} sources are missing: {reasons}"
            )

    def _require_same_times(self, info: SourceInfo) -> None:
        if info.time_base != self._time_base:
            raise RecorderError(
                "some sources are live and some play recorded times; record them separately"
            )

    def _not_begun(self) -> RecordingResult:
        self._stop_workers()
        now_ns = self._clock.log_time_ns(self._clock.now_ns())
        health = HealthSnapshot(now_ns, 0.0, 0, 0, 0.0, (), ())
        message = "stopped as asked, before recording began"
        return RecordingResult("stopped", message, (), 0, self._hanging, health)

    def _head(self) -> Head:
        sources = [lane.announce() for lane in self._lanes if lane.is_there()]
        self._time_base = sources[0].time_base
        for source in sources:
            self._require_same_times(source)
        return Head(
            recording=secrets.token_hex(8),
            sources=sources,
            extra_types=[Diagnostics, ClockSample],
            static_transforms=self._plan.static_transforms,
            settings=self._plan.settings,
            statistics=lambda: statistics_record(self._health()),
            depth_format=self._plan.depth_format,
        )

    def _health(self) -> HealthSnapshot:
        """Return the latest snapshot; the first one is made when it is asked for."""
        if self.snapshot is None:
            self.snapshot = self._monitor.end_interval()
        return self.snapshot

    def _record(
        self, stop: StopFlag, heartbeat: Callable[[HealthSnapshot], object]
    ) -> tuple[Outcome, str]:
        self._monitor.begin()
        for worker in self._workers:
            worker.go()
        try:
            return self._write_until(stop, heartbeat)
        except StreamError as error:
            return "output_failed", str(error)
        finally:
            self._stop_workers()

    def _write_until(
        self, stop: StopFlag, heartbeat: Callable[[HealthSnapshot], object]
    ) -> tuple[Outcome, str]:
        busy_s = 0.0
        while True:
            stopped = pause(stop, self._plan.flush_interval_s - busy_s)
            if stopped:
                self._stop_workers()
            # Looked at before the queues are emptied, so that nothing is left in them.
            over = all(worker.is_over() for worker in self._workers)
            busy_s = self._write_what_is_there()
            if self._monitor.interval_is_over():
                self._output.tend()
                snapshot = self._tell_health()
                with suppress(OSError):
                    heartbeat(snapshot)
            if stopped:
                return "stopped", "recording stopped as asked"
            if over:
                return "ended", self._why_over()

    def _why_over(self) -> str:
        failed = [worker.error for worker in self._workers if worker.state == "lost"]
        return "; ".join(["every source came to its end", *failed])

    def _write_what_is_there(self) -> float:
        """Write what waits in the queues, in order of log time; return how long it took, s."""
        began_s = time.monotonic()
        self._announce_late_sources()
        items = [item for lane in self._lanes for item in lane.take()]
        items.sort(key=_log_time_ns)
        self._write(items)
        busy_s = time.monotonic() - began_s
        self._monitor.note_write(busy_s)
        return busy_s

    def _announce_late_sources(self) -> None:
        for lane in self._lanes:
            if lane.is_new():
                info = lane.announce()
                try:
                    self._require_same_times(info)
                    self._output.add_source(info)
                except OutputEndedError:
                    raise
                except (RecorderError, StreamError) as error:
                    lane.refuse(str(error))

    def _write(self, items: Sequence[Stamped]) -> None:
        self._handed += len(items)
        if items:
            self._newest_ns = items[-1].log_time_ns
        self._output.write(items)

    def _tell_health(self) -> HealthSnapshot:
        """Take the figures of the interval, and write them to /diagnostics."""
        snapshot = self._monitor.end_interval()
        self.snapshot = snapshot
        clocks = self._clock_records.now() if self._is_live() else []
        self._write([*clocks, *self._health_records(snapshot)])
        return snapshot

    def _is_live(self) -> bool:
        """Tell whether this host's time is the recording's; not so when a recording is replayed."""
        return any(lane.is_live() for lane in self._lanes)

    def _health_records(self, snapshot: HealthSnapshot) -> list[Stamped]:
        """Return the figures, stamped now, or with the newest recorded time that is replayed."""
        t_ns = snapshot.t_ns if self._is_live() else self._newest_ns
        if t_ns is None:
            return []
        return [Stamped(t_ns, diagnostics_of(replace(snapshot, t_ns=t_ns)))]

    def _finish(self, outcome: Outcome, message: str) -> RecordingResult:
        try:
            if outcome == "output_failed":
                self.snapshot = self._monitor.end_interval()
            else:
                self._tell_health()
        except StreamError as error:
            outcome, message = "output_failed", str(error)
        try:
            self._output.close()
        except StreamError as error:
            outcome, message = "output_failed", f"{message}; {error}"
        files, health = self._output.files(), self._health()
        return RecordingResult(outcome, message, files, self._unwritten(), self._hanging, health)

    def _unwritten(self) -> int:
        state = self._output.state()
        waiting = sum(worker.queue.state().samples for worker in self._workers)
        return self._handed - state.flushed - state.refused.total() + waiting


def _log_time_ns(item: Stamped) -> int:
    return item.log_time_ns
