"""Gathers the figures of a recording, once a second, in the recording thread.

What is made each second, here and in `snapshot`, builds tuples from lists, and so without
generators: CPython 3.11 makes a tuple of unknown length with room for ten, shrinks it, and keeps
the shrunk memory for later tuples of that length, up to 2000 of each, while the next one is again
made with room for ten. A recording would grow by 1 kB/s for its first half hour.
"""

from __future__ import annotations

from collections.abc import Sequence

from acquisition.clocks.recorder_clock import Clock
from acquisition.health.snapshot import HealthSnapshot, SourceHealth, StreamHealth
from acquisition.messages import codec
from acquisition.recording.lane import Lane
from acquisition.recording.output import OutputState, RecordingOutput

INTERVAL_NS = 1_000_000_000
# A driver must return from each read within its timeout (0.1 s); this one does not any more.
HUNG_AFTER_S = 3.0


class HealthMonitor:
    """Follows the lanes and the output; the time is the clock's."""

    def __init__(self, lanes: Sequence[Lane], output: RecordingOutput, clock: Clock) -> None:
        self._lanes = lanes
        self._output = output
        self._clock = clock
        self._began_ns = self._interval_began_ns = clock.now_ns()
        self._longest_write_s = 0.0

    def begin(self) -> None:
        """Recording begins now."""
        self._began_ns = self._interval_began_ns = self._clock.now_ns()

    def note_write(self, duration_s: float) -> None:
        """Take a flush interval's work into account."""
        self._longest_write_s = max(self._longest_write_s, duration_s)

    def interval_is_over(self) -> bool:
        """Tell whether a second has passed since the last snapshot."""
        return self._clock.now_ns() - self._interval_began_ns >= INTERVAL_NS

    def end_interval(self) -> HealthSnapshot:
        """Return the figures, and begin the next interval."""
        now_ns = self._clock.now_ns()
        duration_s = max(now_ns - self._interval_began_ns, 1) * 1e-9
        state = self._output.state()
        snapshot = HealthSnapshot(
            t_ns=self._clock.log_time_ns(now_ns),
            elapsed_s=(now_ns - self._began_ns) * 1e-9,
            bytes_written=state.bytes_written,
            free_bytes=state.free_bytes,
            longest_write_s=self._longest_write_s,
            sources=tuple([_source(lane, now_ns, duration_s, state) for lane in self._lanes]),
            warnings=state.warnings,
        )
        self._interval_began_ns = now_ns
        self._longest_write_s = 0.0
        return snapshot


def _source(lane: Lane, now_ns: int, duration_s: float, state: OutputState) -> SourceHealth:
    worker = lane.worker
    silent_s = max(0, now_ns - worker.answered_ns) * 1e-9
    name = "hung" if worker.state == "running" and silent_s > HUNG_AFTER_S else worker.state
    return SourceHealth(
        name=worker.name,
        model=worker.info.model if worker.info else "",
        serial=worker.info.serial if worker.info else "",
        state="refused" if lane.refusal else name,
        error=lane.refusal or worker.error,
        losses=worker.losses,
        faults=worker.faults,
        silent_s=silent_s,
        queue=worker.queue.state(),
        streams=_streams(lane, duration_s, state),
        clock_skew_ppm=lane.intake.follower.skew_ppm,
        warning="; ".join(filter(None, (worker.warning, lane.intake.follower.problem))),
    )


def _streams(lane: Lane, duration_s: float, state: OutputState) -> tuple[StreamHealth, ...]:
    return tuple(
        [
            StreamHealth(
                # A depth frame is written as camera and image; the image is what it is known by.
                topic=codec.rows_of(kind)[-1].topic,
                statistics=statistics,
                size_bytes=state.bytes_by_type[kind],
                refused=state.refused[kind],
            )
            for kind, statistics in lane.intake.end_interval(duration_s).items()
        ]
    )
