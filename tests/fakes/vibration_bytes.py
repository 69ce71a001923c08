"""Frames of any vibration profile, as bytes.

Not simulated: what a device would do on purpose. The values are random over their whole range,
and up to a fifth of the frames carries the sync pattern inside, where a value may be that, so the
stream is harsher than a real one.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Mapping

from drivers.vibration.decode import FrameDecoder
from drivers.vibration.profile_tables import ValueField, VibrationProfile


def frame_of(
    profile: VibrationProfile, raw: Mapping[str, tuple[int, ...]], rest: bytes = b""
) -> bytes:
    """Return a correct frame; what is no field is taken from `rest`, or 0."""
    length = profile.frame.shortest
    frame = bytearray(profile.frame.sync + rest[len(profile.frame.sync) :]).ljust(length, b"\0")
    for field in profile.field:
        for offset, value in zip(field.offsets, raw.get(field.name, ()), strict=False):
            field.struct.pack_into(frame, offset, value)
    return _finished(profile, frame)


def _finished(profile: VibrationProfile, frame: bytearray) -> bytes:
    """Return the frame with a time that a clock can show, and its checksum."""
    for part in profile.clock.part if profile.clock else ():
        if part.max is not None:
            told = int(part.struct.unpack_from(frame, part.offset)[0])
            part.struct.pack_into(frame, part.offset, told % (part.max + 1))
    return with_checksum(profile, frame)


def with_checksum(profile: VibrationProfile, frame: bytearray) -> bytes:
    """Return the frame with the checksum that belongs to its bytes."""
    checksum = profile.frame.checksum
    if checksum.kind is not None:
        assert checksum.span is not None
        assert checksum.offset is not None
        value = checksum.kind.compute(bytes(frame[slice(*checksum.span)]))
        code = (">" if checksum.byte_order == "big" else "<") + "BH"[checksum.kind.size - 1]
        struct.pack_into(code, frame, checksum.offset % len(frame), value)
    return bytes(frame)


def random_frames(profile: VibrationProfile, rng: random.Random, count: int) -> list[bytes]:
    """Return correct frames, no two of them alike."""
    frames: dict[bytes, None] = {}
    decoder = FrameDecoder(profile)
    places = [place for field in profile.field for place in _places(field)]
    length, sync = profile.frame.shortest, profile.frame.sync
    while len(frames) < count:
        values = [rng.randrange(low, end) for _, _, low, end in places]
        content = bytearray(sync + rng.randbytes(length)[len(sync) :])
        for (pack_into, offset, _, _), value in zip(places, values, strict=True):
            pack_into(content, offset, value)
        frame = _finished(profile, content)
        if rng.random() < 0.2:
            frame = _with_sync_inside(profile, decoder, frame, rng)
        frames[frame] = None
    return list(frames)


def _places(field: ValueField) -> list[tuple[Callable[..., None], int, int, int]]:
    """Return how and where each value of a field is packed, the lowest and the first too high."""
    low, high = _limits(field)
    return [(field.struct.pack_into, offset, low, high + 1) for offset in field.offsets]


def _with_sync_inside(
    profile: VibrationProfile, decoder: FrameDecoder, frame: bytes, rng: random.Random
) -> bytes:
    """Return the frame with the sync in its payload as well, if its ranges allow it somewhere."""
    sync = profile.frame.sync
    tail = profile.frame.checksum.kind.size if profile.frame.checksum.kind else 0
    for _ in range(10):
        at = rng.randrange(len(sync), len(frame) - tail - len(sync) + 1)
        changed = bytearray(frame)
        changed[at : at + len(sync)] = sync
        if decoder.plausible(bytes(changed)):
            return with_checksum(profile, changed)
    return frame


def _limits(field: ValueField) -> tuple[int, int]:
    """Return the lowest and highest raw value that the field may carry."""
    bits = 8 * field.size
    signed = not field.type.startswith("u")
    low, high = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if signed else (0, 2**bits - 1)
    if field.min is not None:
        low = max(low, round((field.min - field.bias) / field.scale))
    if field.max is not None:
        high = min(high, round((field.max - field.bias) / field.scale))
    return low, high
