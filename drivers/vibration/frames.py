"""Finds frames in a byte stream that may be cut, joined, damaged or mixed with garbage.

`drivers.vibration.candidates` tells which places hold a good candidate. A good candidate is
delivered when no other good candidate overlaps it. Of two that overlap, the one with more further
syncs behind it at its own distance wins; if they are equal, the one that begins where the last
delivered frame ended; if neither does, neither is delivered. After a candidate that is not
delivered the search goes on at its second byte, so a false sync hides no frame. Two that share less
than a sync are both delivered: the first bytes of a frame have completed one that lost its last.

What follows from this, what cannot be guaranteed, and how long a frame may be held back, is in
docs/devices/vibration.md.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from drivers.vibration.candidates import (
    AMBIGUOUS,
    IMPLAUSIBLE,
    WRONG_CHECKSUM,
    Pending,
    judge_for,
)
from drivers.vibration.profile_tables import VibrationProfile

_SLICE_BYTES = 4096
_MOST_FOLLOWERS = 3
_COUNTER_OF_FAULT = {
    WRONG_CHECKSUM: "checksum_errors",
    IMPLAUSIBLE: "implausible",
    AMBIGUOUS: "ambiguous",
}


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame; `end` is the position in the stream just behind its last byte."""

    data: bytes
    end: int


@dataclass(frozen=True, slots=True)
class FrameCounters:
    """What the parser has met since it was made.

    Attributes:
        frames: frames delivered.
        checksum_errors: candidates whose checksum did not agree.
        implausible: candidates with a value out of range that nothing outweighs.
        ambiguous: candidates not delivered because another one, or another reading of the bytes
            around it, was as good or could not be ruled out.
        garbage_bytes: bytes that belong to no delivered frame.
        resyncs: times a frame was found again behind garbage.
    """

    frames: int = 0
    checksum_errors: int = 0
    implausible: int = 0
    ambiguous: int = 0
    garbage_bytes: int = 0
    resyncs: int = 0


class FrameParser:
    """Takes bytes as they come and gives every frame once; holds at most a few frames of bytes.

    The frames do not depend on how the stream was cut into pieces.
    """

    def __init__(self, profile: VibrationProfile) -> None:
        self._judge = judge_for(profile)
        self._pending = Pending(profile.frame.sync)
        self._counts: Counter[str] = Counter()
        self._consumed = 0
        self._shared = 0  # of the pending bytes, how many belong to the last delivered frame
        self._in_garbage = False
        self._expected = -1  # stream position where the last delivered frame ended
        self._contested_to = 0  # end of the last good candidate that a rival kept back

    @property
    def counters(self) -> FrameCounters:
        """The counters so far."""
        return FrameCounters(**self._counts)

    @property
    def position(self) -> int:
        """Where in the stream, bytes, the first pending byte lies: nothing before it is of use."""
        return self._consumed

    @property
    def pending_bytes(self) -> int:
        """Bytes that wait for more before anything can be said of them."""
        return len(self._pending.data)

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that are certain with these bytes, in the order of the stream."""
        frames: list[Frame] = []
        for start in range(0, len(data), _SLICE_BYTES):
            self._pending.data += data[start : start + _SLICE_BYTES]
            frames += self._found()
        return frames

    def end_burst(self) -> list[Frame]:
        """Return the frames that were held back for what might follow: the device is silent.

        The other pending bytes are garbage, and the next byte begins something new.
        """
        self._pending.ended = True
        frames = self._found()
        self._pending.ended = False
        self._discard(self.pending_bytes)
        self._expected = self._consumed
        return frames

    def _found(self) -> list[Frame]:
        frames: list[Frame] = []
        while (frame := self._next()) is not None:
            frames.append(frame)
        return frames

    def _next(self) -> Frame | None:
        """Take the next frame out of the pending bytes, with the garbage in front of it."""
        data, sync, at = self._pending.data, self._pending.sync, 0
        while (at := data.find(sync, at)) >= 0:
            length = self._length_of_frame(at)
            if length != 0:
                self._discard(at)
                return self._take(length) if length else None
            at += 1
        # The last bytes may be the beginning of a sync.
        self._discard(len(data) - len(sync) + 1)
        return None

    def _length_of_frame(self, at: int) -> int | None:
        """Return the length of the frame to deliver from `at`; 0: there is none; None: wait."""
        length = self._judge.length(self._pending, at)
        if length is None:
            return None
        if length <= 0:
            self._counts[_COUNTER_OF_FAULT[length]] += 1
            return 0
        prevails = self._prevails(at, length)
        if prevails is None:
            return None
        self._counts["ambiguous"] += not prevails
        return length if prevails else 0

    def _take(self, length: int) -> Frame:
        frame = bytes(self._pending.data[:length])
        self._shared = self._pending.beginning_of_sync(length)
        del self._pending.data[: length - self._shared]
        self._consumed += length - self._shared
        self._expected = self._consumed + self._shared
        self._counts["frames"] += 1
        self._counts["resyncs"] += self._in_garbage
        self._in_garbage = False
        return Frame(frame, self._expected)

    def _discard(self, count: int) -> None:
        if count > 0:
            del self._pending.data[:count]
            self._consumed += count
            garbage = max(0, count - self._shared)
            self._shared = max(0, self._shared - count)
            self._counts["garbage_bytes"] += garbage
            self._in_garbage = self._in_garbage or garbage > 0

    def _prevails(self, at: int, length: int) -> bool | None:
        """Tell whether a good candidate stands against those that overlap it; None: wait."""
        rivals = self._rivals(at, length)
        if rivals is None:
            return None
        position = self._consumed + at
        if rivals:
            mine = self._followers(at, length)
            theirs = [self._followers(*rival) for rival in rivals]
            if mine is None or None in theirs:
                return None
            best = max(count for count in theirs if count is not None)
            if best != mine:
                return mine > best
        if position == self._expected:
            return True
        if rivals or position < self._contested_to:
            self._contested_to = position + length
            return False
        return True

    def _rivals(self, at: int, length: int) -> list[tuple[int, int]] | None:
        """Return start and length of the good candidates whose sync is inside this one."""
        pending, sync = self._pending, self._pending.sync
        rivals, start = [], at
        while (start := pending.data.find(sync, start + 1, at + length)) >= 0:
            other = self._judge.rival_length(pending, start)
            if other is None:
                return None
            if other > 0:
                rivals.append((start, other))
        return rivals

    def _followers(self, at: int, length: int) -> int | None:
        """Return how many syncs, up to 3, follow this candidate at its own distance."""
        for count in range(_MOST_FOLLOWERS):
            there = self._pending.sync_at(at + (count + 1) * length)
            if not there:
                return None if there is None else count
        return _MOST_FOLLOWERS
