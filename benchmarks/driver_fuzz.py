"""Feed random bytes to everything in drivers/ that takes bytes from outside."""

from __future__ import annotations

import random
import time
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image

from drivers.depth.png import check_headers, read_counts
from drivers.depth.trajectory import read_trajectory
from drivers.errors import DriverError
from drivers.gyro.chips import CHIPS, decode
from drivers.samples import CanFrameSample
from drivers.vibration.decode import FrameDecoder
from drivers.vibration.frames import FrameParser
from drivers.vibration.modbus_replies import refusal
from drivers.vibration.profile import check_profile, load_profile, shipped_profiles
from drivers.wheels.twist_decoder import TwistDecoder
from drivers.wheels.vehicle_layout import vehicle_layout
from tests.drivers.test_vibration_decode import CAPTURED_REPLY
from tests.fakes.vibration_bench import PROFILE_FOLDER
from tests.fakes.vibration_bytes import random_frames

_REQUEST = bytes.fromhex("50 03 00 30 00 17 08 4A")
_PROFILE = PROFILE_FOLDER / "aft601d.toml"
_LONGEST = 80
# Of the frames that the twist is made of.
_IDENTIFIERS = {"puma": (0x02021542, 0x02021543, 0x02021544, 0x02021545), "scout_v2": (0x221,)}


@dataclass(frozen=True, slots=True)
class Fuzzing:
    """What the random strings did to one parser.

    Attributes:
        refused: strings that it answered with a DriverError.
        others: strings that made it raise anything else.
        grown_kib: what it held after the last string more than after the tenth part of them.
        us_per_string: thread CPU time, with the tracing of memory that slows it down.
    """

    parser: str
    strings: int
    refused: int
    others: int
    grown_kib: float
    us_per_string: float


def fuzz(name: str, parse: Callable[[bytes], object], words: list[bytes], count: int) -> Fuzzing:
    """Parse that many strings of 0 to 80 random bytes, half of them with a damaged word inside."""
    rng = random.Random(name)
    strings = [_string(rng, words) for _ in range(count)]
    refused = others = held = 0
    tracemalloc.start()
    begun_s = time.thread_time()
    for number, string in enumerate(strings):
        try:
            parse(string)
        except DriverError:
            refused += 1
        except Exception:  # noqa: BLE001 - what is counted here is exactly that
            others += 1
        if number == count // 10:
            held = tracemalloc.get_traced_memory()[0]
    spent_s = time.thread_time() - begun_s
    grown_kib = (tracemalloc.get_traced_memory()[0] - held) / 1024
    tracemalloc.stop()
    return Fuzzing(name, count, refused, others, round(grown_kib, 1), spent_s * 1e6 / count)


def _string(rng: random.Random, words: list[bytes]) -> bytes:
    data = rng.randbytes(rng.randint(0, _LONGEST))
    if words and rng.random() < 0.5:
        word = bytearray(rng.choice(words))
        for place in rng.choices(range(len(word)), k=rng.randint(0, 3)):
            word[place] = rng.randrange(256)
        place = rng.choice((0, rng.randint(0, len(data))))
        data = data[:place] + bytes(word) + data[place:]
    return data


def fuzz_all(count: int, folder: Path) -> Iterator[Fuzzing]:
    """Yield the figures of each parser; those that read files get them in `folder`."""
    for name in shipped_profiles():
        profile = load_profile(name)
        words = [profile.frame.sync, *random_frames(profile, random.Random(name), 20)]
        yield fuzz(f"stream {name}", FrameParser(profile).feed, words, count)
        yield fuzz(f"frame {name}", FrameDecoder(profile).decode, words, count)
    yield fuzz(
        "modbus reply",
        lambda data: refusal(_REQUEST, data),
        [CAPTURED_REPLY, b"\x50\x83\x02\x91\x20"],
        count,
    )
    for name, chip in CHIPS.items():
        yield fuzz(f"gyro {name}", partial(decode, chip), [], count)
    for vehicle, identifiers in _IDENTIFIERS.items():
        yield fuzz(f"can {vehicle}", _can_parser(vehicle, identifiers), [], count)
    yield from _fuzz_files(count, folder)


def _can_parser(vehicle: str, identifiers: Sequence[int]) -> Callable[[bytes], object]:
    decoder = TwistDecoder(vehicle_layout(vehicle, {}), 0.05)
    rng = random.Random(vehicle)

    def parse(data: bytes) -> object:
        """Decode the bytes as a frame with one of the identifiers."""
        number = rng.choice(identifiers)
        frame = CanFrameSample(0, number, number > 0x7FF, False, False, data[:8], "fuzz", 0)
        return decoder.add(frame)

    return parse


def _fuzz_files(count: int, folder: Path) -> Iterator[Fuzzing]:
    path = folder / "fuzz"

    def reading(parse: Callable[[Path], object]) -> Callable[[bytes], object]:
        """Turn a reader of files into one of bytes."""

        def parse_bytes(data: bytes) -> object:
            path.write_bytes(data)
            return parse(path)

        return parse_bytes

    image = BytesIO()
    Image.fromarray(np.arange(16, dtype=np.uint16).reshape(4, 4)).save(image, "PNG")
    png, toml = [image.getvalue()], [_PROFILE.read_bytes()]
    yield fuzz("png header", reading(lambda p: check_headers([p])), png, count)
    yield fuzz("png pixels", reading(lambda p: read_counts(p, (4, 4))), png, count)
    yield fuzz(
        "trajectory", reading(read_trajectory), [b"1.5 0 0 0 0 0 0 1\n2.5 0 0 0 0 0 0 1\n"], count
    )
    yield fuzz("profile file", reading(check_profile), toml, count)
