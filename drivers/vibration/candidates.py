"""Tells whether the bytes at a place in the stream are a frame: the witnesses of each candidate.

A candidate begins with the sync and is as long as the profile says. Three witnesses can be asked:
its checksum; its ranges (every value of the profile's fields and clock is possible); and its
successor (the next sync stands exactly where it ends). One is not enough where two can be had:

- with a checksum, it must agree, and the ranges or the successor must confirm it;
- without one, the ranges must hold, and the successor must stand there. Failing that, the bytes up
  to the next sync must have no other reading, as a frame into which some of them were inserted.
"""

from __future__ import annotations

from typing import Final, Protocol

from drivers.vibration.decode import FrameDecoder
from drivers.vibration.profile_tables import ByteOrder, FrameSpec, VibrationProfile

WRONG_CHECKSUM: Final = 0
IMPLAUSIBLE: Final = -1
AMBIGUOUS: Final = -2

# How far behind a frame without a checksum its successor is looked for, in frame lengths.
_REACH_FRAMES = 3


class Pending:
    """The bytes of the stream that are not yet judged.

    Attributes:
        data: the bytes.
        sync: what every frame begins with.
        ended: whether the device is known to send nothing behind them.
    """

    def __init__(self, sync: bytes) -> None:
        self.data = bytearray()
        self.sync = sync
        self.ended = False

    def sync_at(self, at: int) -> bool | None:
        """Tell whether the sync stands at `at`; None: too few bytes to say yet."""
        seen = bytes(self.data[at : at + len(self.sync)])
        if len(seen) == len(self.sync):
            return seen == self.sync
        return None if self.sync.startswith(seen) and not self.ended else False

    def beginning_of_sync(self, end: int) -> int:
        """Return how many bytes, fewer than a sync, right before `end` may begin one."""
        most = len(self.sync) - 1
        tail = bytes(self.data[max(0, end - most) : end])
        return next((n for n in range(len(tail), 0, -1) if self.sync.startswith(tail[-n:])), 0)

    def followed(self, end: int) -> bool | None:
        """Tell whether a sync, or the end of what the device sends, stands at `end`; None: wait."""
        return True if self.ended and end == len(self.data) else self.sync_at(end)


class Judge(Protocol):
    """Decides about candidates."""

    def length(self, pending: Pending, at: int) -> int | None:
        """Return the length, bytes, of the good candidate at `at`.

        None: more bytes are needed. Not above 0: it is not good, because of WRONG_CHECKSUM,
        IMPLAUSIBLE or AMBIGUOUS. While `pending.ended` it is never None.
        """

    def rival_length(self, pending: Pending, at: int) -> int | None:
        """Return the same, bytes, but only of what can stand against another good candidate."""


def judge_for(profile: VibrationProfile) -> Judge:
    """Return the judge of a profile's frames."""
    has_checksum = profile.frame.checksum.kind is not None
    return _ByChecksum(profile) if has_checksum else _BySpacing(profile)


class _ByChecksum:
    """The checksum agrees, and the ranges or the successor confirm it."""

    def __init__(self, profile: VibrationProfile) -> None:
        spec = profile.frame
        checksum, kind = spec.checksum, spec.checksum.kind
        if kind is None or checksum.span is None or checksum.offset is None:
            raise ValueError("the profile has no checksum; load it with load_profile")
        self._spec: FrameSpec = spec
        self._kind = kind
        self._span, self._offset = slice(*checksum.span), checksum.offset
        self._order: ByteOrder = checksum.byte_order or "little"
        self._plausible = FrameDecoder(profile).plausible

    def length(self, pending: Pending, at: int) -> int | None:
        """See `Judge`."""
        length = self._told_length(pending, at)
        if length is None or length <= 0:
            return length
        frame = bytes(pending.data[at : at + length])
        if len(frame) < length:
            return IMPLAUSIBLE if pending.ended else None
        start = self._offset % length
        stored = int.from_bytes(frame[start : start + self._kind.size], self._order)
        if stored != self._kind.compute(frame[self._span]):
            return WRONG_CHECKSUM
        if self._plausible(frame):
            return length
        followed = pending.followed(at + length)
        if followed is None:
            return None
        return length if followed else IMPLAUSIBLE

    rival_length = length

    def _told_length(self, pending: Pending, at: int) -> int | None:
        rule = self._spec.length_field
        if rule is None:
            return self._spec.length
        if len(pending.data) < at + rule.offset + rule.size:
            return IMPLAUSIBLE if pending.ended else None
        length = int(rule.struct.unpack_from(pending.data, at + rule.offset)[0]) + rule.add
        return length if rule.min <= length <= rule.max else WRONG_CHECKSUM


class _BySpacing:
    """The ranges hold, and the successor is there or no other reading is possible."""

    def __init__(self, profile: VibrationProfile) -> None:
        self._length = profile.frame.shortest
        self._sync_length = len(profile.frame.sync)
        self._following = profile.frame.following_syncs
        self._plausible = FrameDecoder(profile).plausible

    def length(self, pending: Pending, at: int) -> int | None:
        """See `Judge`."""
        length = self.rival_length(pending, at)
        return self._unfollowed(pending, at) if length == AMBIGUOUS else length

    def rival_length(self, pending: Pending, at: int) -> int | None:
        """See `Judge`: one with successors."""
        possible = self._possible(pending, at)
        if not possible:
            return None if possible is None else IMPLAUSIBLE
        for count in range(1, self._following + 1):
            there = pending.followed(at + count * self._length)
            if not there:
                return None if there is None else AMBIGUOUS
        return self._length

    def _possible(self, pending: Pending, at: int) -> bool | None:
        frame = bytes(pending.data[at : at + self._length])
        if len(frame) < self._length:
            return False if pending.ended else None
        return self._plausible(frame)

    def _unfollowed(self, pending: Pending, at: int) -> int | None:
        """Judge a plausible candidate behind which no sync stands.

        Garbage may have come behind a whole frame, or into a frame whose rest then stands further
        on. Either way the next sync tells how many bytes are too many, up to whole frames: a
        successor whose sync was damaged has the length of one. If cutting as many out of this place
        gives another possible frame, the candidate may be the head of that one with garbage for a
        tail.
        """
        data, end = pending.data, at + self._length
        rival = self._possible_inside(pending, at + 1, end)
        if rival is not False:
            return None if rival is None else AMBIGUOUS
        limit = end + _REACH_FRAMES * self._length
        following = data.find(pending.sync, end, limit)
        if following < 0:
            return AMBIGUOUS if pending.ended or len(data) >= limit else None
        surplus, frame = (following - end) % self._length, data[at:end]
        for cut in range(self._sync_length, self._length):
            other = data[at : at + cut] + data[at + cut + surplus : end + surplus]
            if other != frame and self._plausible(bytes(other)):
                return AMBIGUOUS
        return self._length

    def _possible_inside(self, pending: Pending, at: int, end: int) -> bool | None:
        """Tell whether a possible frame begins from `at` on, before `end`; None: wait."""
        while (at := pending.data.find(pending.sync, at, end + self._sync_length - 1)) >= 0:
            possible = self._possible(pending, at)
            if possible is not False:
                return possible
            at += 1
        return False
