"""A device's counter to the host's clock, from nothing but when its messages arrive.

A message with counter value x arrives at y = a + b x + delay, and the delay has a lower bound and
no upper one. So the line (a, b) runs along the lower convex hull of the points (x, y): the edge
over the middle of the window is the line below all points that is closest to them on average
(Zhang, Liu and Xia, "Clock synchronization algorithms for network measurements", INFOCOM 2002).
The least delay itself cannot be observed one way; it is a constant of the device, to be measured
once (`min_delay_ns`).

Counters and times stay integers, so that nothing is rounded however long a recording is.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from fractions import Fraction

from acquisition.clocks.host_clock import ClockEvent, EventKind
from acquisition.errors import StreamError

_LEAST_WRAP_TICKS = 256


@dataclass(frozen=True, slots=True)
class DeviceClockSettings:
    """What is known about a device's clock.

    Attributes:
        tick_rate_hz: nominal rate of the counter.
        wrap_ticks: how many different values the counter has before it starts over; None when
            it never does.
        window_s: how far back messages count. Long: less noise. Short: follows a clock whose
            rate changes with temperature.
        max_drift_ppm: how far the rate may be from its nominal value, in millionths. Crystals
            stay below 500; RC oscillators need 10000 and more.
        min_delay_ns: the least time from the event to the arrival of its message, from
            calibration; 0 leaves it in the result.
        step_threshold_ns: a message that is so much too early, or all messages of `confirm_s`
            that are so much too late, mean that the device's clock jumped.
        confirm_s: how long a stall of the connection may last without being taken for a jump.
    """

    tick_rate_hz: float
    wrap_ticks: int | None = None
    window_s: float = 60.0
    max_drift_ppm: float = 500.0
    min_delay_ns: int = 0
    step_threshold_ns: int = 100_000_000
    confirm_s: float = 2.0

    def __post_init__(self) -> None:
        """Refuse what makes no sense.

        Raises:
            StreamError: names the value.
        """
        positive = (self.tick_rate_hz, self.window_s, self.step_threshold_ns, self.confirm_s)
        if not all(value > 0 for value in positive):
            raise StreamError(f"{self}: rate, window, threshold and confirm_s must be positive")
        if not 0 <= self.max_drift_ppm < 1e6 or self.min_delay_ns < 0:
            raise StreamError(f"{self}: expected 0 <= max_drift_ppm < 1e6 and min_delay_ns >= 0")
        if self.wrap_ticks is not None and self.wrap_ticks < _LEAST_WRAP_TICKS:
            raise StreamError(
                f"{self}: expected wrap_ticks of at least {_LEAST_WRAP_TICKS} or none"
            )


def unwrapped(ticks: int, wrap_ticks: int, expected: int) -> int:
    """Return the value nearest to `expected` that the counter shows as `ticks`."""
    return ticks + (expected - ticks + wrap_ticks // 2) // wrap_ticks * wrap_ticks


class DeviceClock:
    """Translates counter values, one message after the other.

    The result never runs backwards and never lies behind the arrival.

    Attributes:
        skew_ppm: estimate, host seconds per device second minus one, in millionths.
        offset_ns: estimate, CLOCK_MONOTONIC minus unwrapped ticks at their nominal rate.
    """

    def __init__(self, settings: DeviceClockSettings) -> None:
        self._tick_ns = 1e9 / settings.tick_rate_hz
        self._wrap_ticks = settings.wrap_ticks
        self._window_ticks = round(settings.window_s * settings.tick_rate_hz)
        drift = settings.max_drift_ppm * 1e-6
        self._least_slope = self._tick_ns * (1.0 - drift)
        self._most_slope = self._tick_ns * (1.0 + drift)
        self._slope_spread = self._most_slope - self._least_slope
        self._min_delay_ns = settings.min_delay_ns
        self._step_threshold_ns = settings.step_threshold_ns
        self._confirm_ns = round(settings.confirm_s * 1e9)
        # The hull, from left to right, and the line that was found on it last.
        self._x: list[int] = []
        self._y: list[int] = []
        self._slope = self._tick_ns
        self._pivot = 0
        self._last_x = 0
        self._last_y = 0
        self._last_t_ns = -(1 << 63)
        self._late_since_ns: int | None = None
        self._least_late_ns = 0
        self._events: list[ClockEvent] = []

    @property
    def skew_ppm(self) -> float:
        """The estimate; see the class."""
        return (self._slope / self._tick_ns - 1.0) * 1e6

    @property
    def offset_ns(self) -> int:
        """The estimate, at the last message; see the class."""
        return self._last_t_ns - round(self._last_x * Fraction(self._tick_ns))

    def take_events(self) -> list[ClockEvent]:
        """Return the jumps that were noticed since the last call."""
        events, self._events = self._events, []
        return events

    def translate(self, ticks: int, arrival_ns: int) -> int:
        """Return when the event of a message happened, CLOCK_MONOTONIC.

        Args:
            ticks: the counter in the message.
            arrival_ns: CLOCK_MONOTONIC right after the message was read; must not run backwards.
        """
        x = ticks
        if self._x:
            if self._wrap_ticks is not None:
                passed = round((arrival_ns - self._last_y) / self._tick_ns)
                x = unwrapped(ticks, self._wrap_ticks, self._last_x + passed)
            if self._belongs(x, arrival_ns):
                self._add(x, arrival_ns)
        else:
            self._begin(x, arrival_ns)
        t_ns = self._line_ns(x) - self._min_delay_ns
        if t_ns > self._last_t_ns:
            self._last_t_ns = t_ns
        return self._last_t_ns

    def _line_ns(self, x: int) -> int:
        """Return the earliest arrival of a message with that counter, by the line."""
        pivot = self._pivot
        return self._y[pivot] + int(self._slope * (x - self._x[pivot]))

    def _begin(self, x: int, y: int) -> None:
        """Start the hull anew; the rate of the clock is still what it was."""
        self._x, self._y = [x], [y]
        self._pivot = 0
        self._late_since_ns = None
        self._last_x, self._last_y = x, y

    def _belongs(self, x: int, y: int) -> bool:
        """Tell whether the point belongs to the hull; notice when the device's clock jumped."""
        ahead = x - self._last_x
        late_ns = y - self._line_ns(x)
        if ahead > 0:
            self._last_x, self._last_y = x, y
        tolerance_ns = self._step_threshold_ns + abs(ahead) * self._slope_spread
        if ahead <= 0 and -ahead * self._tick_ns <= self._step_threshold_ns:
            return False  # the same once more, or a little out of order
        if ahead <= 0:
            self._jump("device_restart", x, y, late_ns)
        elif late_ns < -tolerance_ns:
            self._jump("device_step", x, y, late_ns)
        elif late_ns > tolerance_ns:
            self._is_late(x, y, late_ns)
        else:
            self._late_since_ns = None
            return True
        return False

    def _is_late(self, x: int, y: int, late_ns: int) -> None:
        """Tell a stall of the connection, which ends, from a clock that jumped back."""
        if self._late_since_ns is None:
            self._late_since_ns, self._least_late_ns = y, late_ns
        self._least_late_ns = min(self._least_late_ns, late_ns)
        if y - self._late_since_ns >= self._confirm_ns:
            self._jump("device_step", x, y, self._least_late_ns)

    def _jump(self, kind: EventKind, x: int, y: int, late_ns: int) -> None:
        self._events.append(ClockEvent(kind, y, -late_ns))
        self._begin(x, y)

    def _add(self, x: int, y: int) -> None:
        """Put a point at the right end of the hull, and find the line on it."""
        xs, ys = self._x, self._y
        while len(xs) > 1 and (ys[-1] - ys[-2]) * (x - xs[-1]) >= (y - ys[-1]) * (xs[-1] - xs[-2]):
            del xs[-1], ys[-1]
        xs.append(x)
        ys.append(y)
        # The first point may be older, so that the hull covers the whole window.
        while len(xs) > 2 and xs[1] <= x - self._window_ticks:
            del xs[0], ys[0]
        right = bisect_right(xs, (xs[0] + x) >> 1)
        slope = (ys[right] - ys[right - 1]) / (xs[right] - xs[right - 1])
        if self._least_slope <= slope <= self._most_slope:
            self._slope, self._pivot = slope, right
        else:
            self._clamp(slope)

    def _clamp(self, slope: float) -> None:
        """Take the nearest slope that is allowed, and the line of that slope below all points."""
        slope = min(max(slope, self._least_slope), self._most_slope)
        xs, ys = self._x, self._y
        heights = [y - ys[0] - slope * (x - xs[0]) for x, y in zip(xs, ys, strict=True)]
        self._slope, self._pivot = slope, heights.index(min(heights))
