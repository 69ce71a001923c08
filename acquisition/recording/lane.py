"""One source's way through the recorder: its thread, its queue, its intake."""

from __future__ import annotations

from collections.abc import Mapping

from acquisition.clocks.clock_follower import DEFAULT_TUNING, ClockTuning
from acquisition.clocks.recorder_clock import Clock
from acquisition.recording.intake import Intake, Stamped
from acquisition.recording.source_worker import SourceWorker
from drivers.samples import Sample
from drivers.source import SourceInfo


class Lane:
    """One source, as the recording thread sees it.

    Attributes:
        worker: its thread and queue.
        intake: its statistics.
        refusal: why its samples are not recorded, or "".
    """

    def __init__(
        self,
        worker: SourceWorker,
        clock: Clock,
        rates_hz: Mapping[type[Sample], float],
        tuning: ClockTuning = DEFAULT_TUNING,
    ) -> None:
        self.worker = worker
        self.intake = Intake(clock, rates_hz, tuning)
        self.refusal = ""
        self._announced: SourceInfo | None = None

    def is_there(self) -> bool:
        """Tell whether the source has been opened at least once."""
        return self.worker.info is not None

    def is_live(self) -> bool:
        """Tell whether the source has been opened and stamps with this host's clock."""
        return self.worker.info is not None and self.worker.info.time_base == "monotonic"

    def is_new(self) -> bool:
        """Tell whether the source, or the device that answers now, is unknown to the stream."""
        return self.is_there() and self.worker.info != self._announced and not self.refusal

    def announce(self) -> SourceInfo:
        """Return what the stream must know, and remember that it does.

        Raises:
            ValueError: the source has not been opened.
        """
        info = self.worker.info
        if info is None:
            raise ValueError(f"{self.worker.name} has not been opened")
        self._announced = info
        return info

    def refuse(self, reason: str) -> None:
        """Stop the source: what it produces cannot be recorded."""
        self.refusal = reason
        self.worker.stop()

    def take(self) -> list[Stamped]:
        """Return what waits, ready to be written; nothing before the stream knows the source."""
        if self._announced is None or self.is_new() or self.refusal:
            return []
        return [item for batch in self.worker.queue.take() for item in self.intake.stamped(batch)]
