"""Follows a device's counter while its messages are recorded, and says what it found out.

Stamps stay what they are, the time of arrival: what is recorded is raw. The estimate goes to
/clock once a second and into the health figures; `acquisition.clocks.corrected_stamps` applies a
better one to a finished recording.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from acquisition.clocks.clock_sample import ClockSample
from acquisition.clocks.device_clock import DeviceClock, DeviceClockSettings
from acquisition.errors import StreamError
from drivers.source import TickCounter

# Before that, the scatter of the delays hides a clock's rate.
_TRUSTED_AFTER_NS = 10_000_000_000


@dataclass(frozen=True, slots=True)
class ClockTuning:
    """What the user knows about one device's clock; see `DeviceClockSettings`.

    Attributes:
        tick_rate_hz: instead of what the driver says; None leaves it to the driver.
        wrap_ticks: used with `tick_rate_hz`.
        window_s, max_drift_ppm, min_delay_ns: as there.
    """

    tick_rate_hz: float | None = None
    wrap_ticks: int | None = None
    window_s: float = 60.0
    max_drift_ppm: float = 500.0
    min_delay_ns: int = 0

    def settings(self, counter: TickCounter | None) -> DeviceClockSettings | None:
        """Return how to translate such a counter; None where nobody knows its rate.

        Raises:
            StreamError: the values make no sense.
        """
        if self.tick_rate_hz is not None:
            counter = TickCounter(self.tick_rate_hz, self.wrap_ticks)
        if counter is None:
            return None
        return DeviceClockSettings(
            counter.rate_hz,
            counter.wrap_ticks,
            window_s=self.window_s,
            max_drift_ppm=self.max_drift_ppm,
            min_delay_ns=self.min_delay_ns,
        )


DEFAULT_TUNING = ClockTuning()


class ClockFollower:
    """One device's counter; knows nothing until `begin` and `take`.

    Attributes:
        problem: why the counter cannot be followed although it has a rate, or "".
    """

    def __init__(self, tuning: ClockTuning) -> None:
        self.problem = ""
        self._tuning = tuning
        self._clock: DeviceClock | None = None
        self._began_ns = self._arrival_ns = 0
        self._ticks: int | None = None

    def begin(self, counter: TickCounter | None) -> None:
        """The device was opened: its counter may show anything now."""
        self.problem, self._clock = "", None
        self._began_ns, self._ticks = 0, None
        try:
            settings = self._tuning.settings(counter)
        except StreamError as error:
            self.problem = str(error)  # no reason to record nothing
            return
        if settings is not None:
            self._clock = DeviceClock(settings)

    def is_following(self) -> bool:
        """Tell whether the device has a counter whose rate is known."""
        return self._clock is not None

    def take(self, ticks: int, arrival_ns: int) -> None:
        """Take what the counter showed in a message, and CLOCK_MONOTONIC right after its read."""
        if self._clock is None:
            return
        self._clock.translate(ticks, arrival_ns)
        self._began_ns = self._began_ns or arrival_ns
        self._ticks, self._arrival_ns = ticks, arrival_ns

    @property
    def skew_ppm(self) -> float | None:
        """The clock's rate against the host's, as in `ClockSample`; None while it is unknown."""
        if self._clock is None or self._arrival_ns - self._began_ns < _TRUSTED_AFTER_NS:
            return None
        return self._clock.skew_ppm

    def samples(self, source: str, host: ClockSample) -> list[ClockSample]:
        """Return what /clock says about the device: nothing unless a message came since last time.

        Args:
            source: its name.
            host: the host's clocks now; those at the arrival of the message are as much earlier
                as the monotonic clock was.

        Returns:
            One sample, and one more for each jump of the clock, numbered like `host`.
        """
        clock, ticks = self._clock, self._ticks
        if clock is None or ticks is None:
            return []
        self._ticks = None
        age_ns = host.host_monotonic_ns - self._arrival_ns
        sample = replace(
            host,
            source=source,
            host_monotonic_ns=self._arrival_ns,
            host_raw_ns=host.host_raw_ns - age_ns,
            host_real_ns=host.host_real_ns - age_ns,
            offset_ns=clock.offset_ns,
            skew_ppm=clock.skew_ppm,
            device_ticks=ticks,
            event="",
            event_ns=0,
        )
        events = clock.take_events()
        return [sample, *(replace(sample, event=e.kind, event_ns=e.amount_ns) for e in events)]
