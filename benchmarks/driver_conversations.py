"""Gyro, depth camera and CAN adapter, each faked at its lowest level, under stress."""

from __future__ import annotations

import itertools
import struct
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from benchmarks.driver_replug import kill_children
from drivers.depth.openni_depth import OpenNiDepth
from drivers.errors import DriverError, EndOfSource
from drivers.gyro.chips import CHIPS
from drivers.gyro.yaw_gyro import STALL_BOUND_S
from drivers.samples import CanFrameSample, DepthFrame, WheelTwistSample, YawRateSample
from drivers.source import OpenSource
from drivers.wheels.can_wheels import Wheels
from tests.fakes.gyro_bench import FREE_RUNNING, Bench, bench_rate_hz, gaps, gyro_bench, truly_lost
from tests.fakes.oni_file import write_oni
from tests.fakes.slcan_pty import SlcanPty, frame_line

_READ_S = 0.1
_STAMPS_US = [7 + 33_333 * index for index in range(90)]
_CAN_RATE_HZ = 1000.0
_GARBLED = (b"tXYZ2AABB\r", b"t12\r", b"t1238112233\r", b"tFFF0\r", b"t1231G\xff\r")


@dataclass(frozen=True, slots=True)
class Storm:
    """A gyro at 200 Hz of whose transfers 30 % fail, on a clock of its own.

    Attributes:
        failures: transfers that failed.
        lost: samples that are missing, by the chip's own numbering where it has one.
        explained: the most that the failures can have cost, in samples: 0.7 ms for each, and
            8 ms for the check of the settings that follows six in a row.
        unexplained_gaps: gaps longer than the failures inside them explain.
        longest_stall_s: the longest that a read took beyond its time-out.
        stuck_stall_s: the same once the bus is stuck and no transfer succeeds.
        bound_s: what both must keep.
    """

    chip: str
    samples: int
    failures: int
    lost: int
    explained: float
    unexplained_gaps: int
    longest_stall_s: float
    stuck_stall_s: float
    bound_s: float = STALL_BOUND_S


def storms(count: int, seeds: int) -> Iterator[Storm]:
    """Yield each chip's figures: sums over the seeds, of the stalls the longest."""
    for chip in CHIPS:
        yield _together([_storm(chip, count, seed) for seed in range(seeds)])


def _storm(chip: str, count: int, seed: int) -> Storm:
    with pytest.MonkeyPatch.context() as patch:
        bench = gyro_bench(patch, chip, seed=seed)
        with OpenSource(bench.gyro):
            bench.i2c.fail_ratio = 0.30
            samples, stall_s = _read_on(bench, count)
            failures_ns = list(bench.i2c.failures_ns)
            stuck_s = _stuck_stall_s(bench)
    period_s = 1 / bench_rate_hz(chip)
    explained, unexplained = 0.0, 0
    for a, b in itertools.pairwise(samples):
        if missing := b.sequence - a.sequence - 1:
            failures = sum(a.t_ns < t_ns <= b.t_ns for t_ns in failures_ns)
            allowed = (failures * 0.7e-3 + failures // 6 * 8e-3) / period_s
            explained += allowed
            unexplained += missing > allowed
    lost = truly_lost(samples) if chip in FREE_RUNNING else gaps(samples)
    return Storm(
        chip, len(samples), len(failures_ns), lost, explained, unexplained, stall_s, stuck_s
    )


def _read_on(bench: Bench, count: int) -> tuple[list[YawRateSample], float]:
    samples: list[YawRateSample] = []
    longest_s = 0.0
    while len(samples) < count:
        begun_ns = bench.time()
        samples += bench.gyro.read(_READ_S)
        longest_s = max(longest_s, (bench.time() - begun_ns) / 1e9 - _READ_S)
    return samples, max(0.0, longest_s)


def _stuck_stall_s(bench: Bench) -> float:
    """Return the longest that five reads took beyond their time-out on a stuck bus."""
    bench.i2c.stuck = True
    longest_s = 0.0
    for _ in range(5):
        begun_ns = bench.time()
        with pytest.raises(DriverError):
            bench.gyro.read(_READ_S)
        longest_s = max(longest_s, (bench.time() - begun_ns) / 1e9 - _READ_S)
    bench.i2c.stuck = False
    return longest_s


def _together(storms: Sequence[Storm]) -> Storm:
    return Storm(
        storms[0].chip,
        sum(s.samples for s in storms),
        sum(s.failures for s in storms),
        sum(s.lost for s in storms),
        sum(s.explained for s in storms),
        sum(s.unexplained_gaps for s in storms),
        max(s.longest_stall_s for s in storms),
        max(s.stuck_stall_s for s in storms),
    )


@dataclass(frozen=True, slots=True)
class Playback:
    """A generated recording of 90 frames, played by the real libOpenNI2.

    Attributes:
        equal_frames: frames that came back pixel for pixel.
        equal_stamps: frames whose stamp is the written one.
        damaged: whether the file or the helper was, so that an error must end it.
        end: how it ended, with the words of the error.
    """

    recording: str
    frames: int
    equal_frames: int
    equal_stamps: int
    damaged: bool
    end: str


def playbacks(folder: Path) -> Iterator[Playback]:
    """Yield what comes of whole recordings, of a truncated one, and of a killed helper."""
    rng = np.random.default_rng(90)
    for width, height in ((320, 240), (640, 480)):
        frames = [rng.integers(0, 65536, (height, width), dtype=np.uint16) for _ in _STAMPS_US]
        path = folder / f"{width}x{height}.oni"
        write_oni(path, frames, _STAMPS_US)
        yield _play(path.stem, path, frames, damaged=False)
    data = path.read_bytes()
    yield _play("helper killed after 30 frames", path, frames, damaged=True, kill_after=30)
    truncated = folder / "truncated.oni"
    truncated.write_bytes(data[: len(data) // 2])
    yield _play("truncated to half", truncated, frames, damaged=True)


def _play(
    name: str,
    path: Path,
    written: Sequence[np.ndarray],
    *,
    damaged: bool,
    kill_after: int | None = None,
) -> Playback:
    frames: list[DepthFrame] = []
    with OpenSource(source := OpenNiDepth(file=path, silence_s=1.0)):
        try:
            while True:
                frames += [s for s in source.read(5.0) if isinstance(s, DepthFrame)]
                if len(frames) == kill_after:
                    kill_children()
        except (DriverError, EndOfSource) as end:
            words = f"{type(end).__name__}: {str(end).replace(str(path), path.name)}"
    equal = [np.array_equal(f.depth_mm, w) for f, w in zip(frames, written, strict=False)]
    stamps = [f.t_ns == 1000 * us for f, us in zip(frames, _STAMPS_US, strict=False)]
    return Playback(name, len(frames), sum(equal), sum(stamps), damaged, words)


@dataclass(frozen=True, slots=True)
class CanRun:
    """Frames through slcan on a pseudo-terminal, in real time.

    Attributes:
        sent: frames sent, in `seconds`.
        received: frames received, with the right bytes and in order.
        twists: wheel twists decoded from them, of a quarter as many expected.
        garbled_sent: damaged lines between the frames.
        garbled: lines that the driver counted as garbled.
    """

    sent: int
    seconds: float
    received: int
    twists: int
    garbled_sent: int
    garbled: int


def can_run(count: int, folder: Path) -> CanRun:
    """Send frames at 1 kHz, and a damaged line behind every hundredth, and read them."""
    lines = [_speed_line(number) for number in range(count)]
    payloads: list[bytes] = []
    sent = twists = 0
    with SlcanPty(folder / "ttyCAN") as adapter:
        wheels = Wheels(str(adapter.path), interface="slcan", bus_options={"sleep_after_open": 0})
        with OpenSource(wheels):
            begun_s = time.monotonic()
            quiet_s = 0.0
            while quiet_s < 1.0 and len(payloads) < count:
                due = min(count, int((time.monotonic() - begun_s) * _CAN_RATE_HZ))
                adapter.feed(lines[sent:due])
                sent = due
                waiting = adapter.pump()
                read_s = time.monotonic()
                samples = wheels.read(0.01)
                payloads += [s.data for s in samples if isinstance(s, CanFrameSample)]
                twists += sum(isinstance(s, WheelTwistSample) for s in samples)
                idle = sent == count and not waiting and not samples
                quiet_s = quiet_s + time.monotonic() - read_s if idle else 0.0
            seconds = time.monotonic() - begun_s
            garbled = wheels.bus_counters.garbled
    right = sum(a == _speed(number) for number, a in enumerate(payloads))
    return CanRun(count, seconds, right, twists, count // 100, garbled)


def _speed(number: int) -> bytes:
    return struct.pack("<i", 65536 * number)


def _speed_line(number: int) -> bytes:
    """Return the line of one wheel's speed; the four wheels take turns."""
    device = (2, 3, 5, 4)[number % 4]
    line = frame_line(0x02021540 | device, _speed(number), extended=True)
    return line + (_GARBLED[number // 100 % len(_GARBLED)] if number % 100 == 99 else b"")
