"""What happened on one stream of one source: rate, gaps, losses, jitter of the stamps."""

from __future__ import annotations

import math
from dataclasses import dataclass

MAX_GAP_PERIODS = 5.0
# The estimated period follows the last hundred samples or so, and is trusted after twenty.
_PERIOD_WEIGHT = 0.01
_TRUSTED_AFTER = 20


@dataclass(frozen=True, slots=True)
class StreamStatistics:
    """One stream in figures; all but rate and jitter since the start of the recording.

    Attributes:
        samples: that were handed on to be written.
        missed: lost before they reached the recorder, by the source's own numbers.
        gaps: times without a sample, longer than five periods or because the source was lost.
        gap_s: their sum.
        longest_gap_s: the longest of them.
        backwards: stamps older than the one before.
        rate_hz: over the last interval, by the host's clock; of a recording that is played or a
            drive that is simulated by the samples' own times, however fast they come. None when
            nothing came in it.
        nominal_rate_hz: as expected; None = unknown.
        jitter_s: standard deviation of the time between samples over the last interval.
    """

    samples: int
    missed: int
    gaps: int
    gap_s: float
    longest_gap_s: float
    backwards: int
    rate_hz: float | None
    nominal_rate_hz: float | None
    jitter_s: float | None


class StreamTrack:
    """Follows one stream. Times are of the samples, in ns; nothing in here looks at a clock."""

    def __init__(self, nominal_rate_hz: float | None) -> None:
        self._nominal_rate_hz = nominal_rate_hz
        # The longest step that is no gap; any may be one or not while the period is unknown.
        self._longest_ns = MAX_GAP_PERIODS * 1e9 / nominal_rate_hz if nominal_rate_hz else math.inf
        self._samples = self._missed = self._gaps = self._backwards = 0
        self._gap_ns = self._longest_gap_ns = 0
        self._last_ns: int | None = None
        self._last_sequence = -1
        self._sequence_offset = 0
        self._learnt_steps = 0
        self._learnt_ns = 0.0
        self._new_interval()

    def _new_interval(self) -> None:
        self._samples_before = self._samples
        self._began_ns, self._periods = self._last_ns, 0
        self._steps = 0
        self._sum_ns = self._sum_squares_ns2 = 0.0

    def accept(self, t_ns: int, sequence: int, *, reopened: bool, dropped: int) -> int:
        """Take the next sample into account.

        A source that was opened again counts from 0 again; the recording counts on, so that a
        sequence number names one sample.

        Args:
            t_ns: its time.
            sequence: its number at the source.
            reopened: the source was lost and found before this sample.
            dropped: samples of this stream that the recorder threw away just before it.

        Returns:
            Its number in the recording.
        """
        number = sequence + self._sequence_offset
        if number != self._last_sequence + 1:
            self._count_missed(sequence, reopened=reopened, dropped=dropped)
            number = sequence + self._sequence_offset
        self._last_sequence = number
        self._samples += 1
        last_ns, self._last_ns = self._last_ns, t_ns
        if last_ns is None:
            self._began_ns = t_ns
        else:
            self._periods += 1
            self._count_step(t_ns - last_ns, reopened=reopened)
        return number

    def _count_missed(self, sequence: int, *, reopened: bool, dropped: int) -> None:
        lost = sequence + self._sequence_offset - self._last_sequence - 1
        if lost < 0:
            self._sequence_offset = self._last_sequence + 1 - sequence
        elif self._samples and not reopened:  # else nobody knows what the source would have sent
            self._missed += max(0, lost - dropped)

    def _count_step(self, step_ns: int, *, reopened: bool) -> None:
        if 0 <= step_ns <= self._longest_ns and not reopened:
            self._steps += 1
            self._sum_ns += step_ns
            self._sum_squares_ns2 += float(step_ns) * step_ns
            if self._nominal_rate_hz is None:
                self._learn_period(step_ns)
        elif step_ns < 0:
            self._backwards += 1
        else:
            self._gaps += 1
            self._gap_ns += step_ns
            self._longest_gap_ns = max(self._longest_gap_ns, step_ns)

    def _learn_period(self, step_ns: int) -> None:
        """Estimate the period of a source that does not tell it: the mean, then a slow filter."""
        self._learnt_steps += 1
        weight = max(1.0 / self._learnt_steps, _PERIOD_WEIGHT)
        self._learnt_ns += weight * (step_ns - self._learnt_ns)
        if self._learnt_steps >= _TRUSTED_AFTER:
            self._longest_ns = MAX_GAP_PERIODS * self._learnt_ns

    def end_interval(self, duration_s: float | None) -> StreamStatistics:
        """Return the figures, those of the interval included, and begin the next interval.

        Args:
            duration_s: of the interval, for the rate; None = as long as its samples say.
        """
        statistics = StreamStatistics(
            samples=self._samples,
            missed=self._missed,
            gaps=self._gaps,
            gap_s=self._gap_ns * 1e-9,
            longest_gap_s=self._longest_gap_ns * 1e-9,
            backwards=self._backwards,
            rate_hz=self._rate_hz(duration_s),
            nominal_rate_hz=self._nominal_rate_hz,
            jitter_s=self._jitter_s(),
        )
        self._new_interval()
        return statistics

    def _rate_hz(self, duration_s: float | None) -> float | None:
        if duration_s is not None:
            return (self._samples - self._samples_before) / duration_s or None
        if self._last_ns is None or self._began_ns is None or self._last_ns <= self._began_ns:
            return None
        return self._periods * 1e9 / (self._last_ns - self._began_ns)

    def _jitter_s(self) -> float | None:
        if self._steps < 2:
            return None
        mean_ns = self._sum_ns / self._steps
        return math.sqrt(max(0.0, self._sum_squares_ns2 / self._steps - mean_ns**2)) * 1e-9
