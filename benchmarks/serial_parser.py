"""Count what the parser of serial frames loses, repeats and invents in damaged streams.

    python -m benchmarks.serial_parser --seeds 30 --frames 100000 --json parser.json

For every shipped profile and kind of damage (`tests.fakes.vibration_damage`), streams in which one
frame in twenty is damaged are cut at random places and parsed. The columns:

    damaged   frames that do not stand in the stream unbroken
    alone     intact frames behind which no sync follows: without a checksum the doubtful ones
    lost      intact frames not delivered
    repeated  frames delivered a second time
    invented  frames delivered whose bytes are none of a frame that was sent
    expected  how many inventions nothing in the bytes could prevent. Each place of the stream that
              holds a sync and stands in no intact frame is a candidate; counted are those whose
              values are all possible or behind which a sync follows, times the 2^-16 that their
              checksum agrees by chance; without a checksum, those that have both. Too low for
              flips: four changed bits pass CRC-16-Modbus more often than that
    pending   most bytes held back at any time
    ns/byte   median of thread CPU time per byte
"""

from __future__ import annotations

import argparse
import json
import random
import statistics
import time
from bisect import bisect_right
from dataclasses import asdict, dataclass
from pathlib import Path

from drivers.vibration.decode import FrameDecoder
from drivers.vibration.frames import Frame, FrameParser
from drivers.vibration.profile import load_profile, shipped_profiles
from drivers.vibration.profile_tables import VibrationProfile
from tests.fakes.vibration_bytes import random_frames
from tests.fakes.vibration_damage import DamagedStream, damaged_stream, pieces

KINDS = ("random", "hostile", "flips")


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one stream, or all streams of a kind, came to; see the module's columns."""

    damaged: int
    alone: int
    lost: int
    repeated: int
    invented: int
    expected: float
    pending: int
    ns_per_byte: float


def main() -> None:
    """Parse, print, and write the figures to a file where asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seeds", type=int, default=30, help="streams of each kind; default 30")
    parser.add_argument("--frames", type=int, default=100_000, help="in a stream; default 100000")
    parser.add_argument("--profiles", nargs="+", default=shipped_profiles(), help="default all")
    parser.add_argument("--json", type=Path, help="file for the figures")
    arguments = parser.parse_args()
    print(
        f"{'profile':<16}{'damage':<8}{'damaged':>8}{'alone':>8}{'lost':>7}{'repeated':>9}"
        f"{'invented':>9}{'expected':>9}{'pending':>8}{'ns/byte':>8}"
    )
    rows = []
    for name in arguments.profiles:
        profile = load_profile(name)
        frames = random_frames(profile, random.Random(name), arguments.frames)
        for kind in KINDS:
            seeds = [random.Random(f"{name} {kind} {seed}") for seed in range(arguments.seeds)]
            total = together([parsed(profile, frames, kind, rng) for rng in seeds])
            print(
                f"{name:<16}{kind:<8}{total.damaged:>8}{total.alone:>8}{total.lost:>7}"
                f"{total.repeated:>9}{total.invented:>9}{total.expected:>9.3g}"
                f"{total.pending:>8}{total.ns_per_byte:>8.0f}",
                flush=True,
            )
            rows.append({"profile": name, "damage": kind, **asdict(total)})
    if arguments.json:
        figures = {"seeds": arguments.seeds, "frames": arguments.frames, "rows": rows}
        arguments.json.write_text(json.dumps(figures, indent=2))


def parsed(
    profile: VibrationProfile, frames: list[bytes], kind: str, rng: random.Random
) -> Outcome:
    """Damage the frames in one way, parse the stream, and say what came of it."""
    stream = damaged_stream(profile, frames, rng, kind=kind)
    parser = FrameParser(profile)
    cuts = list(pieces(stream.data, rng))
    delivered: list[Frame] = []
    pending, begun_s = 0, time.thread_time()
    for cut in cuts:
        delivered += parser.feed(cut)
        pending = max(pending, parser.pending_bytes)
    spent_s = time.thread_time() - begun_s
    ends = {frame.end for frame in delivered}
    sent = stream.decoys.union(frames)
    return Outcome(
        damaged=len(frames) - len(stream.intact),
        alone=alone(profile, stream),
        lost=sum(end not in ends for end in stream.intact.values()),
        repeated=len(delivered) - len(ends),
        invented=sum(frame.data not in sent for frame in delivered),
        expected=expected_inventions(profile, stream, sent),
        pending=pending,
        ns_per_byte=spent_s * 1e9 / len(stream.data),
    )


def alone(profile: VibrationProfile, stream: DamagedStream) -> int:
    """Return how many intact frames have no sync right behind them."""
    sync = profile.frame.sync
    return sum(not stream.data.startswith(sync, end) for end in stream.intact.values())


def expected_inventions(
    profile: VibrationProfile, stream: DamagedStream, sent: frozenset[bytes]
) -> float:
    """Return how many false candidates pass every test that the bytes allow, on average."""
    data, sync, length = stream.data, profile.frame.sync, profile.frame.shortest
    ends = sorted(stream.intact.values())
    plausible = FrameDecoder(profile).plausible
    has_checksum = profile.frame.checksum.kind is not None
    passed, at = 0, -1
    while 0 <= (at := data.find(sync, at + 1)) <= len(data) - length:
        next_end = bisect_right(ends, at)
        if next_end < len(ends) and ends[next_end] - length <= at:
            continue  # an intact frame, or inside one
        candidate = data[at : at + length]
        witnesses = plausible(candidate) + data.startswith(sync, at + length)
        passed += witnesses >= (1 if has_checksum else 2) and candidate not in sent
    return passed / 65536 if has_checksum else passed


def together(outcomes: list[Outcome]) -> Outcome:
    """Return the sums; of the bytes held back the largest, of the times the median."""
    return Outcome(
        damaged=sum(o.damaged for o in outcomes),
        alone=sum(o.alone for o in outcomes),
        lost=sum(o.lost for o in outcomes),
        repeated=sum(o.repeated for o in outcomes),
        invented=sum(o.invented for o in outcomes),
        expected=sum(o.expected for o in outcomes),
        pending=max(o.pending for o in outcomes),
        ns_per_byte=statistics.median(o.ns_per_byte for o in outcomes),
    )


if __name__ == "__main__":
    main()
