"""Samples from the thread that stamps them to the thread that writes them, within a bound."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from threading import Lock
from typing import NamedTuple

from drivers.samples import DepthFrame, Sample
from drivers.source import SourceInfo

# What a sample without an image takes in memory, generously (measured: 300 to 700 bytes).
SMALL_SAMPLE_BYTES = 1024
_NOTHING: Counter[type[Sample]] = Counter()


class Batch(NamedTuple):
    """What reads of a source gave, one after the other, with nothing lost between them.

    Attributes:
        info: the source, as it was when it was opened.
        samples: those that found room.
        dropped_before: samples that were thrown away since the batch before this one, by type.
        reopened: the source was lost and found between the batch before and this one.
    """

    info: SourceInfo
    samples: list[Sample]
    dropped_before: Counter[type[Sample]]
    reopened: bool


@dataclass(frozen=True, slots=True)
class QueueState:
    """How full a queue is.

    Attributes:
        samples: waiting now.
        size_bytes: memory that they take.
        limit_bytes: memory that they may take.
        highest_bytes: the most that they ever took.
        dropped: samples that found no room, since the start.
    """

    samples: int
    size_bytes: int
    limit_bytes: int
    highest_bytes: int
    dropped: int


def size_in_memory(sample: Sample) -> int:
    """Return about how many bytes a sample takes."""
    if type(sample) is DepthFrame:  # not isinstance, which takes twice as long for all others
        return SMALL_SAMPLE_BYTES + sample.depth_mm.nbytes
    return SMALL_SAMPLE_BYTES


class SampleQueue:
    """One source's queue. `put` never waits: what finds no room is counted and thrown away.

    The newest is what goes, so that what is in the queue stays without gaps.
    """

    def __init__(self, limit_bytes: int) -> None:
        self._lock = Lock()
        self._limit_bytes = limit_bytes
        self._batches: list[Batch] = []
        # The batch that grows: one of many samples is cheaper to handle than many of one.
        self._last: Batch | None = None
        self._size_bytes = 0
        self._highest_bytes = 0
        self._dropped = 0
        self._dropped_untold = _NOTHING

    def put(self, info: SourceInfo, samples: Sequence[Sample], *, reopened: bool = False) -> None:
        """Take what has room; called by the source's thread."""
        needed_bytes = 0
        for sample in samples:
            needed_bytes += size_in_memory(sample)
        with self._lock:
            last, size_bytes = self._last, self._size_bytes + needed_bytes
            if last is None or last.info is not info or reopened or size_bytes > self._limit_bytes:
                self._put_into_new_batch(info, samples, reopened=reopened)
            else:
                last.samples.extend(samples)
                self._size_bytes = size_bytes

    def _put_into_new_batch(
        self, info: SourceInfo, samples: Sequence[Sample], *, reopened: bool
    ) -> None:
        kept = self._that_fit(samples)
        if kept or reopened:
            self._last = Batch(info, kept, self._dropped_untold, reopened)
            self._batches.append(self._last)
            self._dropped_untold = _NOTHING
        lost = samples[len(kept) :]
        if lost:
            self._last = None  # the next batch has to tell
            self._dropped += len(lost)
            self._dropped_untold = self._dropped_untold + Counter(map(type, lost))

    def _that_fit(self, samples: Sequence[Sample]) -> list[Sample]:
        """Return the first of them that find room, and count their bytes."""
        kept: list[Sample] = []
        for sample in samples:
            size_bytes = self._size_bytes + size_in_memory(sample)
            if size_bytes > self._limit_bytes:
                break
            self._size_bytes = size_bytes
            kept.append(sample)
        return kept

    def take(self) -> list[Batch]:
        """Return everything that waits; called by the writing thread."""
        with self._lock:
            batches, self._batches, self._last = self._batches, [], None
            self._highest_bytes = max(self._highest_bytes, self._size_bytes)
            self._size_bytes = 0
        return batches

    def state(self) -> QueueState:
        """Return how full it is."""
        with self._lock:
            return QueueState(
                sum(len(batch.samples) for batch in self._batches),
                self._size_bytes,
                self._limit_bytes,
                max(self._highest_bytes, self._size_bytes),
                self._dropped,
            )
