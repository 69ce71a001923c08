"""What /clock says: how a device's clock, the host's and the real time were related."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ClockSample:
    """One line of the record that lets every stamp be computed anew.

    Attributes:
        t_ns: time of the sample, in the time in which the other samples of its stream are.
        source: the device, or "host".
        host_monotonic_ns: CLOCK_MONOTONIC, at the arrival of the device's message.
        host_raw_ns: CLOCK_MONOTONIC_RAW at that moment, which no time server corrects.
        host_real_ns: CLOCK_REALTIME at that moment.
        boot_id: of the host; the clocks above count from its start.
        offset_ns: estimate, to be added to the device's time (unwrapped ticks at their nominal
            rate) to get CLOCK_MONOTONIC; for the host, to CLOCK_MONOTONIC to get log time.
        skew_ppm: estimate, host seconds per device second minus one, in millionths.
        device_ticks: the device's own counter, unwrapped by nobody; None for the host.
        event: "" or the kind of `acquisition.clocks.host_clock.ClockEvent` that was noticed.
        event_ns: its amount.
        sequence: counter of the source, starting at 0.
    """

    t_ns: int
    source: str
    host_monotonic_ns: int
    host_raw_ns: int
    host_real_ns: int
    boot_id: str
    offset_ns: int
    skew_ppm: float = 0.0
    device_ticks: int | None = None
    event: str = ""
    event_ns: int = 0
    sequence: int = 0
