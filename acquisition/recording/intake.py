"""One source's samples on their way into the stream: recording time, numbers, statistics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from operator import attrgetter
from typing import Any, NamedTuple

from acquisition.clocks.clock_follower import ClockFollower, ClockTuning
from acquisition.clocks.recorder_clock import Clock
from acquisition.health.stream_track import StreamStatistics, StreamTrack
from acquisition.messages.codec import Recordable
from acquisition.recording.sample_queue import Batch
from drivers.samples import DepthFrame, Sample, VibrationSample
from drivers.source import SourceInfo

_FOLLOWED_EVERY_NS = 10_000_000


class Stamped(NamedTuple):
    """Something to be written, and the time by which the stream is ordered."""

    log_time_ns: int
    record: Recordable


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
        self._followed_ns = 0
        self._clock = clock
        self._rates_hz = rates_hz
        self._tracks: dict[type[Sample], StreamTrack] = {}
        self._reopened: set[type[Sample]] = set()

    def stamped(self, batch: Batch) -> list[Stamped]:
        """Return the batch's samples as they go into the stream."""
        dropped = batch.dropped_before
        if batch.reopened:
            self._reopened = set(self._tracks)
        live = batch.info.time_base == "monotonic"
        if live:
            self._follow(batch)
        stamped: list[Stamped] = []
        for sample in batch.samples:
            kind = type(sample)
            sequence, dropped_here = self._track(kind, batch).accept(
                sample.t_ns,
                sample.sequence,
                reopened=kind in self._reopened,
                dropped=dropped,
            )
            dropped -= dropped_here
            self._reopened.discard(kind)
            t_ns = self._clock.log_time_ns(sample.t_ns) if live else sample.t_ns
            stamped.append(Stamped(t_ns, restamped(sample, t_ns, sequence)))
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

    def _track(self, kind: type[Sample], batch: Batch) -> StreamTrack:
        if kind not in self._tracks:
            announced = batch.info.nominal_rate_hz.get(kind)
            self._tracks[kind] = StreamTrack(self._rates_hz.get(kind, announced))
        return self._tracks[kind]

    def end_interval(self, duration_s: float) -> dict[type[Sample], StreamStatistics]:
        """Return the figures of each stream and begin the next interval."""
        return {kind: track.end_interval(duration_s) for kind, track in self._tracks.items()}


def restamped(sample: Sample, t_ns: int, sequence: int) -> Sample:
    """Return the sample with another time and number; `dataclasses.replace`, but faster."""
    values, time_at, number_at = _fields_of(type(sample))
    changed = list(values(sample))
    changed[time_at] = t_ns
    changed[number_at] = sequence
    return type(sample)(*changed)


_Fields = tuple[Callable[[Sample], tuple[Any, ...]], int, int]
_FIELDS: dict[type[Sample], _Fields] = {}


def _fields_of(kind: type[Sample]) -> _Fields:
    """Return what gives all fields of such a sample, and the places of time and number."""
    known = _FIELDS.get(kind)
    if known is None:
        names = [field.name for field in fields(kind)]
        places = names.index("t_ns"), names.index("sequence")
        known = _FIELDS[kind] = (attrgetter(*names), *places)
    return known
