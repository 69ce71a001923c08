"""One source's thread: open it, read it, find it again when it is lost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from threading import Event, Thread
from typing import Literal

from acquisition.clocks.recorder_clock import Clock
from acquisition.recording.sample_queue import SampleQueue
from acquisition.recording.thread_priority import raise_priority
from drivers.errors import DriverError, EndOfSource, TerravibeError
from drivers.faults import NO_FAULTS
from drivers.source import Source, SourceInfo

# How often the driver is asked for its faults.
_FAULTS_EVERY_NS = 500_000_000
# How often a source that may not be recorded yet is emptied; a serial port keeps 4 kB.
_EMPTIED_EVERY_S = 0.02

WorkerState = Literal["opening", "ready", "running", "lost", "ended", "closed"]


@dataclass(frozen=True, slots=True)
class WorkerSettings:
    """How a source is treated.

    Attributes:
        queue_limit_bytes: memory that samples may take while they wait to be written.
        read_timeout_s: longest wait in one read; a stop is noticed within it.
        reconnect_s: pause between two attempts to open a source.
        realtime_priority: SCHED_FIFO priority of the thread, 0 = none.
    """

    queue_limit_bytes: int = 64 << 20
    read_timeout_s: float = 0.1
    reconnect_s: float = 1.0
    realtime_priority: int = 0


class SourceWorker:
    """Reads one source in a thread of its own, so that its failures and pauses stay its own.

    Attributes:
        queue: where the samples are.
        state: what the thread is doing.
        info: what the source said when it was last opened; None before that.
        error: why it was last lost or could not be opened; "" while all is well.
        losses: how often it was lost after it had been opened.
        faults: what its driver lost and mended while it was read; what `open` met is not in it.
        answered_ns: when its last read returned, by the monotonic clock.
        warning: why the thread runs without the priority that was asked for, or "".
    """

    def __init__(self, source: Source, clock: Clock, settings: WorkerSettings) -> None:
        self.name = source.name
        self.queue = SampleQueue(settings.queue_limit_bytes)
        self.state: WorkerState = "opening"
        self.info: SourceInfo | None = None
        self.error = ""
        self.losses = 0
        self.faults = NO_FAULTS
        self.answered_ns = clock.now_ns()
        self.warning = ""
        self._source = source
        self._clock = clock
        self._settings = settings
        self._go = Event()
        self._stop = Event()
        self._tried = Event()
        # A daemon, because a driver that hangs in a dead device must not keep the program alive.
        self._thread = Thread(target=self._live, name=f"source {self.name}", daemon=True)

    def start(self) -> None:
        """Start the thread, which opens the source and then waits for `go`."""
        self._thread.start()

    def wait_until_tried(self, timeout_s: float) -> bool:
        """Wait for the first attempt to open the source; false when it takes too long."""
        return self._tried.wait(timeout_s)

    def go(self) -> None:
        """Begin to read."""
        self._go.set()

    def is_over(self) -> bool:
        """Tell whether nothing more will come; what came before is in the queue."""
        return self.state in ("ended", "closed") or not self._thread.is_alive()

    def stop(self) -> None:
        """Ask the thread to close the source and end; does not wait."""
        self._stop.set()
        self._go.set()

    def join(self, timeout_s: float) -> bool:
        """Wait for the thread; false when it hangs."""
        if self._thread.ident is not None:
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _live(self) -> None:
        self.warning = raise_priority(self._settings.realtime_priority)
        while not self._stop.is_set():
            self._survives(self._serve)
            self._tried.set()
            state, error = self.state, self.error
            self._survives(self._source.close)
            if state == "ended" or self._has_played():
                self.state, self.error = state, error
                return
            self._stop.wait(self._settings.reconnect_s)
        self.state = "closed"

    def _has_played(self) -> bool:
        """Tell whether recorded times failed: opened again, they would begin once more."""
        return self.losses > 0 and self.info is not None and self.info.time_base == "recorded"

    def _survives(self, step: Callable[[], None]) -> None:
        """Run a step of the driver; whatever it raises is kept as the error of this source."""
        try:
            step()
        except EndOfSource:
            self.state = "ended"
        except TerravibeError as error:
            self._lost(str(error))
        except Exception as error:  # noqa: BLE001 - a driver's defect must not end the others' recording
            self._lost(f"{self.name}: defect in the driver: {type(error).__name__}: {error}")

    def _lost(self, error: str) -> None:
        self.losses += self.state == "running"
        self.state = "lost"
        self.error = error

    def _serve(self) -> None:
        """Open the source, wait until reading may begin, and read until something ends it."""
        info = self._source.open()
        if not info.produces:
            raise DriverError(f"{self.name}: produces no samples")
        self.info = info
        self.error = ""
        self.state = "ready"
        self._tried.set()
        self._wait_for_go(info)
        before, earlier = self._source.faults, self.faults

        def note_faults() -> None:
            """Take the driver's counts, on top of those of its earlier openings."""
            self.faults = self._source.faults.since(before).plus(earlier)

        try:
            self._read(info, note_faults)
        finally:
            note_faults()

    def _wait_for_go(self, info: SourceInfo) -> None:
        """Throw away what a live source gives meanwhile: read later, it would be stamped later."""
        while not self._go.wait(_EMPTIED_EVERY_S):
            while info.time_base == "monotonic" and self._source.read(0.0):
                if self._go.is_set():
                    return

    def _read(self, info: SourceInfo, note_faults: Callable[[], None]) -> None:
        reopened = self.losses > 0
        self.state = "running"
        # Looked up once: this loop turns thousands of times a second.
        read, timeout_s, put = self._source.read, self._settings.read_timeout_s, self.queue.put
        stopped, now_ns = self._stop.is_set, self._clock.now_ns
        faults_due_ns = now_ns()
        while not stopped():
            samples = read(timeout_s)
            self.answered_ns = now_ns()
            if samples:
                put(info, samples, reopened=reopened)
                reopened = False
            if self.answered_ns >= faults_due_ns:
                note_faults()
                faults_due_ns = self.answered_ns + _FAULTS_EVERY_NS
        self.state = "closed"  # what `close` meets is no loss
