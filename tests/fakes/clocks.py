"""Clocks that a test moves by hand, and a device whose messages arrive late.

What is not faked: a clock that is slewed, and a connection that loses messages.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from acquisition.clocks.host_clock import SystemClocks

S = 1_000_000_000
Int64Array = NDArray[np.int64]


@dataclass
class FakeHost:
    """The clocks of a host; `clocks` is what `HostClock` takes."""

    monotonic_ns: int = 5 * S
    real_offset_ns: int = 1_700_000_000 * S
    slept_ns: int = 0
    reading_takes_ns: int = 0
    clocks: SystemClocks = field(init=False)

    def __post_init__(self) -> None:
        self.clocks = SystemClocks(
            monotonic_ns=self._monotonic,
            raw_ns=lambda: self.monotonic_ns + 11,
            real_ns=lambda: self.monotonic_ns + self.slept_ns + self.real_offset_ns,
            boot_ns=lambda: self.monotonic_ns + self.slept_ns,
            boot_id=lambda: "boot-1",
        )

    def _monotonic(self) -> int:
        self.monotonic_ns += self.reading_takes_ns
        return self.monotonic_ns

    def suspend(self, duration_ns: int) -> None:
        """Sleep: the real-time clock goes on, the monotonic one does not."""
        self.slept_ns += duration_ns


@dataclass(frozen=True)
class DeviceMessages:
    """Messages of a device: when it happened, what the counter showed, when it arrived."""

    event_ns: Int64Array
    ticks: Int64Array
    arrival_ns: Int64Array


def kinect(
    seed: int,
    *,
    seconds: float = 300.0,
    rate_hz: float = 30.0,
    tick_rate_hz: float = 60e6,
    drift_ppm: float = 40.0,
    base_delay_ns: int = 8_000_000,
    jitter_ns: float = 2e6,
    stall_share: float = 0.01,
) -> DeviceMessages:
    """Return the messages of a Kinect whose clock is fast by `drift_ppm`, not wrapped.

    The delay is a constant, the absolute value of a normal number, and now and then a stall of
    20 to 80 ms; messages arrive in order.
    """
    chance = np.random.default_rng(seed)
    count = int(seconds * rate_hz)
    event_s = 100.0 + np.arange(count) / rate_hz
    ticks = np.floor((event_s * (1.0 + drift_ppm * 1e-6) + 3.0) * tick_rate_hz).astype(np.int64)
    delay_ns = base_delay_ns + np.abs(chance.normal(0.0, jitter_ns, count))
    stalls = chance.random(count) < stall_share
    delay_ns = delay_ns + stalls * chance.uniform(20e6, 80e6, count)
    event_ns = np.round(event_s * 1e9).astype(np.int64)
    arrival_ns = np.maximum.accumulate(event_ns + delay_ns.astype(np.int64))
    return DeviceMessages(event_ns, ticks, arrival_ns)
