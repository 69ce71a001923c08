"""Finds frames in a byte stream that may be cut, joined, damaged or mixed with garbage.

A candidate begins with the sync and is as long as the profile says. It is good
- with a checksum, when the checksum agrees;
- without one, when every field lies within its min..max and the next sync (or `following_syncs`
  of them) stands exactly one frame length further.

A good candidate is delivered when no other good candidate overlaps it. Of two that overlap, the one
with more further syncs behind it at its own distance wins; if they are equal, the one that begins
where the last delivered frame ended; if neither does, neither is delivered. After a candidate that
is not delivered the search goes on at its second byte, so a false sync hides no frame.

What follows from this, and what cannot be guaranteed, is in docs/devices/vibration.md.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Protocol

from drivers.vibration.decode import FrameDecoder
from drivers.vibration.profile_tables import ByteOrder, FrameSpec, VibrationProfile

_SLICE_BYTES = 4096
_MOST_FOLLOWERS = 3


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
        implausible: without a checksum, candidates with a value out of range or without the next
            sync at the right distance.
        ambiguous: good candidates not delivered because another one overlapped them.
        garbage_bytes: bytes that belong to no delivered frame.
        resyncs: times a frame was found again behind garbage.
    """

    frames: int = 0
    checksum_errors: int = 0
    implausible: int = 0
    ambiguous: int = 0
    garbage_bytes: int = 0
    resyncs: int = 0


class _Rule(Protocol):
    """Decides whether a candidate is good."""

    def good(self, buffer: bytearray, at: int) -> int | None:
        """Return the length of the good candidate at `at`; 0: it is not good; None: wait."""


class FrameParser:
    """Takes bytes as they come and gives every frame once; holds at most a few frames of bytes.

    The frames do not depend on how the stream was cut into pieces.
    """

    def __init__(self, profile: VibrationProfile) -> None:
        self._sync = profile.frame.sync
        has_checksum = profile.frame.checksum.kind is not None
        self._rule: _Rule = _Checksum(profile.frame) if has_checksum else _Spacing(profile)
        # A reply stands alone: nothing that could rival it follows, and nobody may wait for it.
        self._arbitrates = profile.link.mode == "stream"
        self._bad_counter = "checksum_errors" if has_checksum else "implausible"
        self._counts: Counter[str] = Counter()
        self._buffer = bytearray()
        self._consumed = 0
        self._in_garbage = False
        self._expected = -1  # stream position where the last delivered frame ended
        self._contested_to = 0  # end of the last good candidate that a rival kept back

    @property
    def counters(self) -> FrameCounters:
        """The counters so far."""
        return FrameCounters(**self._counts)

    @property
    def position(self) -> int:
        """Where in the stream the first pending byte lies: nothing before it is of use."""
        return self._consumed

    @property
    def pending_bytes(self) -> int:
        """Bytes that wait for more before anything can be said of them."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that are complete with these bytes, in the order of the stream."""
        frames: list[Frame] = []
        for start in range(0, len(data), _SLICE_BYTES):
            self._buffer += data[start : start + _SLICE_BYTES]
            while (frame := self._next()) is not None:
                frames.append(frame)
        return frames

    def _next(self) -> Frame | None:
        """Take the next frame out of the buffer, with the garbage in front of it."""
        at = 0
        while (at := self._buffer.find(self._sync, at)) >= 0:
            length = self._length_of_frame(at)
            if length != 0:
                self._discard(at)
                return self._take(length) if length else None
            at += 1
        # The last bytes may be the beginning of a sync.
        self._discard(len(self._buffer) - len(self._sync) + 1)
        return None

    def _length_of_frame(self, at: int) -> int | None:
        """Return the length of the frame to deliver from `at`; 0: there is none; None: wait."""
        length = self._rule.good(self._buffer, at)
        if length == 0:
            self._counts[self._bad_counter] += 1
        if not (length and self._arbitrates):
            return length
        prevails = self._prevails(at, length)
        if prevails is None:
            return None
        self._counts["ambiguous"] += not prevails
        return length if prevails else 0

    def _take(self, length: int) -> Frame:
        data = bytes(self._buffer[:length])
        del self._buffer[:length]
        self._consumed += length
        self._expected = self._consumed
        self._counts["frames"] += 1
        self._counts["resyncs"] += self._in_garbage
        self._in_garbage = False
        return Frame(data, self._consumed)

    def _discard(self, count: int) -> None:
        if count > 0:
            del self._buffer[:count]
            self._consumed += count
            self._counts["garbage_bytes"] += count
            self._in_garbage = True

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
        """Return start and length of the good candidates that begin inside this one."""
        buffer, sync = self._buffer, self._sync
        rivals, start, end = [], at, at + length
        while (start := buffer.find(sync, start + 1, end + len(sync) - 1)) >= 0:
            other = self._rule.good(buffer, start)
            if other is None:
                return None
            if other:
                rivals.append((start, other))
        if any(_sync_at(buffer, place, sync) is None for place in range(end - len(sync) + 1, end)):
            return None
        return rivals

    def _followers(self, at: int, length: int) -> int | None:
        """Return how many syncs, up to 3, follow this candidate at its own distance."""
        for count in range(_MOST_FOLLOWERS):
            there = _sync_at(self._buffer, at + (count + 1) * length, self._sync)
            if not there:
                return None if there is None else count
        return _MOST_FOLLOWERS


class _Checksum:
    """A candidate is good when its checksum agrees."""

    def __init__(self, spec: FrameSpec) -> None:
        checksum, kind = spec.checksum, spec.checksum.kind
        if kind is None or checksum.span is None or checksum.offset is None:
            raise ValueError("the profile has no checksum; load it with load_profile")
        self._spec, self._kind = spec, kind
        self._span, self._offset = slice(*checksum.span), checksum.offset
        self._order: ByteOrder = checksum.byte_order or "little"

    def good(self, buffer: bytearray, at: int) -> int | None:
        length = self._length(buffer, at)
        if not length:
            return length
        frame = bytes(buffer[at : at + length])
        if len(frame) < length:
            return None
        start = self._offset % length
        stored = int.from_bytes(frame[start : start + self._kind.size], self._order)
        return length if stored == self._kind.compute(frame[self._span]) else 0

    def _length(self, buffer: bytearray, at: int) -> int | None:
        rule = self._spec.length_field
        if rule is None:
            return self._spec.length
        if len(buffer) < at + rule.offset + rule.size:
            return None
        length = int(rule.struct.unpack_from(buffer, at + rule.offset)[0]) + rule.add
        return length if rule.min <= length <= rule.max else 0


class _Spacing:
    """A candidate is good when its values are possible and the next sync is where it belongs."""

    def __init__(self, profile: VibrationProfile) -> None:
        self._sync = profile.frame.sync
        self._length = profile.frame.shortest
        self._following = profile.frame.following_syncs
        self._plausible = FrameDecoder(profile).plausible

    def good(self, buffer: bytearray, at: int) -> int | None:
        frame = bytes(buffer[at : at + self._length])
        if len(frame) < self._length:
            return None
        if not self._plausible(frame):
            return 0
        for count in range(1, self._following + 1):
            there = _sync_at(buffer, at + count * self._length, self._sync)
            if not there:
                return None if there is None else 0
        return self._length


def _sync_at(buffer: bytearray, at: int, sync: bytes) -> bool | None:
    """Tell whether the sync stands at `at`; None: too few bytes to say."""
    seen = bytes(buffer[at : at + len(sync)])
    if not sync.startswith(seen):
        return False
    return True if len(seen) == len(sync) else None
