"""Frames and damaged streams of any vibration profile, as bytes.

Not simulated: what a device would do on purpose. The values are random over their whole range,
and a fifth of the frames carries the sync pattern inside, so the stream is harsher than a real one.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

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
    limits = {field.name: _limits(field) for field in profile.field}
    while len(frames) < count:
        raw = {
            field.name: tuple(rng.randint(*limits[field.name]) for _ in field.offsets)
            for field in profile.field
        }
        frame = frame_of(profile, raw, rng.randbytes(profile.frame.shortest))
        if rng.random() < 0.2:
            frame = _with_sync_inside(profile, decoder, frame, rng)
        frames[frame] = None
    return list(frames)


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
        if tail or decoder.plausible(bytes(changed)):
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


@dataclass(frozen=True)
class DamagedStream:
    """A stream of frames with garbage in it.

    `intact` are the frames that stand in the data unbroken: nothing else may be delivered.
    `undamaged` are those that must be delivered: with a checksum all intact ones, without one
    the intact ones behind which the next sync follows at once.
    """

    data: bytes
    intact: list[bytes]
    undamaged: set[bytes]


def damaged_stream(
    profile: VibrationProfile, frames: list[bytes], rng: random.Random, share: float = 0.05
) -> DamagedStream:
    """Put up to 40 bytes of garbage before or into `share` of the frames."""
    decoys = random_frames(profile, rng, 1000)
    data = bytearray()
    ends: dict[bytes, int] = {}
    for frame in frames:
        segment = frame
        if rng.random() < share:
            segment = _spoiled(profile, frame, rng.choice(decoys), rng)
        if frame in segment:
            ends[frame] = len(data) + segment.index(frame) + len(frame)
        data += segment
    data += bytes(4 * len(frames[-1]))  # so that nothing still waits for more
    sync = b"" if profile.frame.checksum.kind else profile.frame.sync
    undamaged = {frame for frame, end in ends.items() if data.startswith(sync, end)}
    return DamagedStream(bytes(data), list(ends), undamaged)


def _spoiled(profile: VibrationProfile, frame: bytes, decoy: bytes, rng: random.Random) -> bytes:
    """Return the frame behind a part of another one, or with noise before or inside it."""
    sync, place = profile.frame.sync, rng.randrange(len(frame))
    noise = rng.choice((sync * rng.randint(1, 4), rng.randbytes(rng.randint(1, 40))))
    return rng.choice(
        (
            decoy[: rng.randrange(1, len(decoy))] + frame,
            frame[:place] + noise + frame[place:],
            noise + frame,
        )
    )


def pieces(data: bytes, rng: random.Random, longest: int = 96) -> Iterator[bytes]:
    """Cut the data at random places."""
    at = 0
    while at < len(data):
        size = rng.randint(1, longest)
        yield data[at : at + size]
        at += size
