"""One source's samples on their way into the stream: recording time, numbers, statistics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import NamedTuple

from acquisition.clocks.clock_follower import ClockFollower, ClockTuning
from acquisition.clocks.recorder_clock import Clock
from acquisition.health.stream_track import StreamStatistics, StreamTrack
from acquisition.messages.codec import Recordable
from acquisition.recording.sample_queue import Batch
from drivers.samples import DepthFrame, Sample, VibrationSample
from drivers.source import SourceInfo

_FOLLOWED_EVERY_NS = 10_000_000


class Stamped(NamedTuple):
    """Something to be written.

    Attributes:
        log_time_ns: its time in the stream, by which that is ordered.
        record: what is written, under that time instead of its own.
        sequence: its number in the stream; None leaves it its own.
    """

    log_time_ns: int
    record: Recordable
    sequence: int | None = None


class Intake:
    """Turns the batches of one source into what is written.

    A live source stamps with the monotonic clock, which means nothing to others; in the stream
    every stamp is in the clock's log time. Samples that carry recorded times keep them.

    Attributes:
        follower: follows the source's own clock.
    """

    def __init__(
        self, clock: Clock, rates_hz: Mapping[type[Sample], float], tuning: ClockTuning
    ) -> None:
        """Expect these rates; where one is missing, what the source itself says."""
        self.follower = ClockFollower(tuning)
        self._info: SourceInfo | None = None
        self._is_live = True
        self._followed_ns = 0
        self._clock = clock
        self._rates_hz = rates_hz
        self._tracks: dict[type[Sample], StreamTrack] = {}
        self._reopened: set[type[Sample]] = set()
        self._dropped: Counter[type[Sample]] = Counter()

    def stamped(self, batch: Batch) -> list[Stamped]:
        """Return the batch's samples as they go into the stream."""
        dropped = self._dropped
        if batch.dropped_before:
            dropped.update(batch.dropped_before)
        if batch.reopened:
            self._reopened = set(self._tracks)
        live = self._is_live = batch.info.time_base == "monotonic"
        if live:
            self._follow(batch)
        to_log_time_ns = self._clock.log_time_ns
        stamped: list[Stamped] = []
        for sample in batch.samples:
            kind, t_ns = type(sample), sample.t_ns
            reopened = kind in self._reopened
            track = self._tracks.get(kind) or self._begin_track(kind, batch)
            sequence = track.accept(
                t_ns,
                sample.sequence,
                reopened=reopened,
                dropped=dropped.pop(kind, 0) if dropped else 0,
            )
            if reopened:
                self._reopened.discard(kind)
            log_time_ns = to_log_time_ns(t_ns) if live else t_ns
            stamped.append(Stamped(log_time_ns, sample, sequence))
        return stamped

    def _follow(self, batch: Batch) -> None:
        """Show the follower the samples with ticks, a hundred a second at most."""
        if batch.reopened or batch.info is not self._info:
            self._info = batch.info
            self.follower.begin(batch.info.counter)
            self._followed_ns = -_FOLLOWED_EVERY_NS
        if not self.follower.is_following():
            return
        for sample in batch.samples:
            if (
                isinstance(sample, DepthFrame | VibrationSample)
                and sample.device_ticks is not None
                and sample.t_ns - self._followed_ns >= _FOLLOWED_EVERY_NS
            ):
                self.follower.take(sample.device_ticks, sample.t_ns)
                self._followed_ns = sample.t_ns

    def _begin_track(self, kind: type[Sample], batch: Batch) -> StreamTrack:
        announced = batch.info.nominal_rate_hz.get(kind)
        track = self._tracks[kind] = StreamTrack(self._rates_hz.get(kind, announced))
        return track

    def end_interval(self, duration_s: float) -> dict[type[Sample], StreamStatistics]:
        """Return the figures of each stream and begin the next interval.

        Args:
            duration_s: of the interval by the host's clock, which says nothing of recorded times.
        """
        duration = duration_s if self._is_live else None
        return {kind: track.end_interval(duration) for kind, track in self._tracks.items()}
