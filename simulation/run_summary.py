"""A simulated run in a few lines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass


@dataclass(frozen=True, slots=True)
class SimulatedRun:
    """What was driven and written.

    Attributes:
        output: the recording. truth: the file of what is true.
        samples: in the recording, of each type by its name.
        bytes: length of the recording.
        duration_s: of the drive.
        took_s: of wall time.
        stuck_s: how long the rover was stuck.
    """

    output: str
    truth: str
    samples: Mapping[str, int]
    bytes: int
    duration_s: float
    took_s: float
    stuck_s: float

    def as_json(self) -> dict[str, object]:
        """Return the summary as JSON values, under the names of its attributes."""
        return asdict(self)

    def describe(self) -> list[str]:
        """Return the summary as lines for people."""
        samples, speed = sum(self.samples.values()), self.duration_s / self.took_s
        return [
            f"{self.output}: {samples} samples of {self.duration_s:g} s, {self.bytes} bytes",
            f"{self.truth}: terrain, visible cells, poses and signals; the mapper never opens it",
            f"took {self.took_s:.1f} s, {speed:.2f} times as fast as real time",
        ]
