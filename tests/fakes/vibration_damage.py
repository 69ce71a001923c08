"""Streams of vibration frames with damage in them, and what must be found in them.

Not simulated: the time between the bytes, and errors that come in longer bursts than one frame.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from drivers.vibration.profile_tables import VibrationProfile
from tests.fakes.vibration_bytes import random_frames


@dataclass(frozen=True)
class DamagedStream:
    """A stream of frames with garbage in it.

    `intact` maps the frames that stand in the data unbroken to where they end: nothing else may
    be delivered. `undamaged` are those that every parser can know to be whole: with a checksum
    all intact ones, without one the intact ones behind which the next sync follows at once.
    `decoys` are the frames from which hostile garbage is cut: a part of one with the right bytes
    behind it by chance is that frame, and no parser can know that nobody sent it.
    """

    data: bytes
    intact: Mapping[bytes, int]
    undamaged: set[bytes]
    decoys: frozenset[bytes]


@dataclass(frozen=True)
class _Bench:
    """What a kind of damage may use: the sync, other frames, and chance."""

    sync: bytes
    decoys: list[bytes]
    rng: random.Random

    def noise(self) -> bytes:
        return self.rng.randbytes(self.rng.randint(1, 40))

    def syncs(self) -> bytes:
        return self.sync * self.rng.randint(1, 4)

    def beginning(self) -> bytes:
        decoy = self.rng.choice(self.decoys)
        return decoy[: self.rng.randrange(1, len(decoy))]

    def fragment(self) -> bytes:
        decoy = self.rng.choice(self.decoys)
        start = self.rng.randrange(1, len(decoy))
        return decoy[start : self.rng.randint(start + 1, len(decoy))]

    def inserted(self, frame: bytes, garbage: bytes) -> bytes:
        place = self.rng.randrange(len(frame))
        return frame[:place] + garbage + frame[place:]


def _mixed(bench: _Bench, frame: bytes) -> bytes:
    """Part of another frame before this one, or noise or syncs before or inside it."""
    garbage = bench.rng.choice((bench.syncs, bench.noise))()
    return bench.rng.choice(
        (bench.beginning() + frame, bench.inserted(frame, garbage), garbage + frame)
    )


def _random(bench: _Bench, frame: bytes) -> bytes:
    """1 to 40 random bytes before the frame or inside it."""
    garbage = bench.noise()
    return bench.rng.choice((garbage + frame, bench.inserted(frame, garbage)))


def _hostile(bench: _Bench, frame: bytes) -> bytes:
    """Parts of frames, or syncs, before the frame or inside it; or the frame cut short."""
    garbage = bench.rng.choice((bench.syncs, bench.beginning, bench.fragment))()
    cut = frame[: bench.rng.randrange(1, len(frame))]
    return bench.rng.choice((garbage + frame, bench.inserted(frame, garbage), cut))


def _flips(bench: _Bench, frame: bytes) -> bytes:
    """1 to 8 bits of the frame turned over."""
    changed = int.from_bytes(frame, "big")
    for place in bench.rng.sample(range(8 * len(frame)), bench.rng.randint(1, 8)):
        changed ^= 1 << place
    return changed.to_bytes(len(frame), "big")


DAMAGE: Mapping[str, Callable[[_Bench, bytes], bytes]] = {
    "mixed": _mixed,
    "random": _random,
    "hostile": _hostile,
    "flips": _flips,
}


def damaged_stream(
    profile: VibrationProfile,
    frames: list[bytes],
    rng: random.Random,
    share: float = 0.05,
    kind: str = "mixed",
) -> DamagedStream:
    """Damage `share` of the frames in one of the ways of `DAMAGE`."""
    decoys = random_frames(profile, rng, min(len(frames), 1000))
    bench, damage = _Bench(profile.frame.sync, decoys, rng), DAMAGE[kind]
    data = bytearray()
    ends: dict[bytes, int] = {}
    for frame in frames:
        segment = damage(bench, frame) if rng.random() < share else frame
        if frame in segment:
            ends[frame] = len(data) + segment.index(frame) + len(frame)
        data += segment
    data += bytes(4 * len(frames[-1]))  # so that nothing still waits for more
    sync = b"" if profile.frame.checksum.kind else profile.frame.sync
    undamaged = {frame for frame, end in ends.items() if data.startswith(sync, end)}
    return DamagedStream(bytes(data), ends, undamaged, frozenset(bench.decoys))


def pieces(data: bytes, rng: random.Random, longest: int = 96) -> Iterator[bytes]:
    """Cut the data at random places."""
    at = 0
    while at < len(data):
        size = rng.randint(1, longest)
        yield data[at : at + size]
        at += size
