"""When simulated devices measure, when their samples arrive, and which of them do."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.samples import Sample
from simulation.errors import SimulationError
from simulation.faults import Device

Int64Array = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class DeviceClock:
    """How a device keeps time and how late the host sees it.

    Attributes:
        rate_hz: nominal sample rate, by the device's own clock.
        drift_ppm: how much the device's clock runs fast.
        latency_s: from the measurement to the host's stamp, at least.
        jitter_s: mean of the exponentially distributed delay on top.
    """

    rate_hz: float
    drift_ppm: float = 0.0
    latency_s: float = 0.0
    jitter_s: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.rate_hz <= 1000.0:
            raise SimulationError(f"rate_hz is {self.rate_hz}; expected above 0 and up to 1000 Hz")
        if not (abs(self.drift_ppm) <= 10_000.0 and 0.0 <= self.latency_s <= 10.0):
            raise SimulationError(
                f"drift_ppm {self.drift_ppm}, latency_s {self.latency_s}; expected at most "
                "10000 ppm either way and 0 to 10 s"
            )
        if not 0.0 <= self.jitter_s <= 1.0:
            raise SimulationError(f"jitter_s is {self.jitter_s}; expected 0 to 1 s")

    @property
    def speed(self) -> float:
        """Return device seconds per second."""
        return 1.0 + self.drift_ppm * 1e-6

    def edges_ns(self, start_ns: int, duration_ns: int, random: np.random.Generator) -> Int64Array:
        """Return (N + 1,) times between which N samples are measured, at a random phase.

        Without a sample in that time N is 0, and the one edge may be later than the end.
        """
        period_ns = 1e9 / self.rate_hz / self.speed
        phase = random.random()
        count = math.floor(duration_ns / period_ns - phase) + 1
        elapsed_ns = np.rint((phase + np.arange(max(count, 1))) * period_ns)
        return np.asarray(start_ns + elapsed_ns.astype(np.int64), np.int64)

    def stamps_ns(self, measured_ns: Int64Array, random: np.random.Generator) -> Int64Array:
        """Return the host's stamps of measurements; they strictly increase."""
        delay_s = self.latency_s + self.jitter_s * random.standard_exponential(measured_ns.size)
        return increasing(measured_ns + np.rint(delay_s * 1e9).astype(np.int64))


def increasing(t_ns: Int64Array) -> Int64Array:
    """Return times put off as little as needed to increase by 1 ns at least."""
    steps = np.arange(t_ns.size, dtype=np.int64)
    return np.asarray(np.maximum.accumulate(t_ns - steps) + steps, np.int64)


@dataclass(frozen=True, slots=True)
class DeviceStream:
    """One type of samples of one device, in the order of their stamps.

    Samples are made when they are asked for; iterating again gives the same ones.

    Attributes:
        device: where they come from.
        kind: the type of the samples.
        measured_ns: (N,) true times of all measurements, the lost ones included; a measurement
            over a period has the time of its end.
        arrived: (N,) which of them got through.
        make: sample from its index and its sequence number.
        counts_lost: the device numbers its measurements, so lost ones leave a gap.
    """

    device: Device
    kind: type[Sample]
    measured_ns: Int64Array
    arrived: NDArray[np.bool_]
    make: Callable[[int, int], Sample]
    counts_lost: bool = False

    def __len__(self) -> int:
        return int(np.count_nonzero(self.arrived))

    def __iter__(self) -> Iterator[Sample]:
        for position, index in enumerate(np.flatnonzero(self.arrived).tolist()):
            yield self.make(index, index if self.counts_lost else position)
