"""What the recorder writes to /clock once a second: the host's clocks, and each device's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from acquisition.clocks.recorder_clock import Clock
from acquisition.recording.intake import Stamped
from acquisition.recording.lane import Lane


class ClockRecords:
    """Numbers them in the order in which they are written."""

    def __init__(self, lanes: Sequence[Lane], clock: Clock) -> None:
        self._lanes = lanes
        self._clock = clock
        self._sequence = 0

    def now(self) -> list[Stamped]:
        """Return what there is to be said, in log time."""
        samples = self._clock.samples(0)
        host = samples[0]
        for lane in self._lanes:
            samples += lane.intake.follower.samples(lane.worker.name, host)
        records = []
        for sample in samples:
            t_ns = self._clock.log_time_ns(sample.t_ns)
            records.append(Stamped(t_ns, replace(sample, t_ns=t_ns, sequence=self._sequence)))
            self._sequence += 1
        return records
