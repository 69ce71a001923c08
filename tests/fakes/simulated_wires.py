"""Simulated signals on the wires of the faked devices, for unmodified drivers to read.

What a simulated sample holds goes back into the registers, frames and bytes that a device would
have sent. Not simulated: when it would have sent them (all comes as fast as it is read). The
assumed AFT601D sends no accelerations; they come from a second sensor with a profile of its own.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from drivers.errors import EndOfSource
from drivers.faults import Faults
from drivers.samples import (
    AccelerationSample,
    CanFrameSample,
    DepthFrame,
    Sample,
    VibrationSample,
    YawRateSample,
)
from drivers.source import Source, SourceInfo
from drivers.vibration.profile import load_profile
from tests.fakes.fake_time import FakeTime
from tests.fakes.gyro_registers import EpsonXv
from tests.fakes.oni_file import write_oni
from tests.fakes.pty_endpoint import PtyEndpoint
from tests.fakes.slcan_pty import frame_line
from tests.fakes.vibration_bytes import frame_of

# A sensor that streams its raw chip: 16 g over 16 bits, a thousand times a second.
RAW_PROFILE = f"""
[profile]
name = "raw-acceleration"
device = "accelerometer of the tests"
source = "none: invented for the tests"
verified = false

[serial]
baud = 460800
data_bits = 8
parity = "none"
stop_bits = 1

[link]
mode = "stream"
nominal_rate_hz = 1000.0
identify_within_s = 2.0

[frame]
sync = "AA 55"
length = 10

[frame.checksum]
algorithm = "crc16-modbus"
span = [0, -2]
offset = -2
byte_order = "little"

[[field]]
name = "acceleration"
offsets = [2, 4, 6]
type = "int16"
byte_order = "little"
scale = {16.0 * 9.80665 / 32768.0!r}
unit = "m/s^2"

[sample]
amplitude = "acceleration"
quantity = "acceleration"
statistic = "instantaneous"
specific_force = "acceleration"
axes = ["x", "y", "z"]
"""
_NO_VALUE = 2**16 - 1
_PUMP_EVERY_S = 0.0005


class Finite:
    """A device that is pulled out after a number of samples: ends instead of falling silent."""

    def __init__(self, device: Source, samples: int) -> None:
        self.name = device.name
        self._device = device
        self._left = samples

    @property
    def faults(self) -> Faults:
        """Those of the device."""
        return self._device.faults

    def open(self) -> SourceInfo:
        """Open the device."""
        return self._device.open()

    def read(self, timeout_s: float) -> Sequence[Sample]:
        """Read the device until it has given so many samples."""
        if self._left <= 0:
            raise EndOfSource
        samples = self._device.read(timeout_s)
        self._left -= len(samples)
        return samples

    def close(self) -> None:
        """Close the device."""
        self._device.close()


class SignalGyro(EpsonXv):
    """An XV7001BB that turns as simulated.

    The first reading of the rate register is the first sample; from there the chip's own time
    goes on, so that each reading falls into the middle of a sample.
    """

    def __init__(self, time: FakeTime, samples: Sequence[YawRateSample], rate_hz: float) -> None:
        super().__init__(time)
        self._samples = samples
        self._signal_hz = rate_hz
        self._first_ns: int | None = None

    def read(self, length: int) -> bytes:
        if self._pointer & 0x7F == 0x08:
            celsius = self._now().temperature_c
            assert celsius is not None
            raw = round(16.0 * (celsius - 25.0)) + 400
            return (raw << 4).to_bytes(2, "big", signed=True)[:length]
        return super().read(length)

    def _rate(self) -> bytes:
        self._first_ns = self._first_ns or self.time.now_ns
        raw = self._now().raw_counts
        assert raw is not None
        return raw.to_bytes(3, "big", signed=True)

    def _now(self) -> YawRateSample:
        elapsed_ns = 0 if self._first_ns is None else self.time.now_ns - self._first_ns
        index = int(elapsed_ns * 1e-9 * self._signal_hz + 0.5)
        return self._samples[min(index, len(self._samples) - 1)]


def vibration_frames(samples: Iterable[VibrationSample]) -> list[bytes]:
    """Return the frames that an AFT601D, as it is assumed, would send."""
    profile = load_profile("aft601d")
    steps = {field.name: field.scale for field in profile.field}
    frames = []
    for sample in samples:
        assert sample.device_ticks is not None
        assert sample.temperature_c is not None
        raw = {
            "displacement": tuple(_count(v, steps["displacement"]) for v in sample.amplitude),
            "frequency": tuple(_count(v, steps["frequency"]) for v in sample.frequency_hz),
            "temperature": (_count(sample.temperature_c, steps["temperature"]),),
        }
        clock = bytes(2) + sample.device_ticks.to_bytes(4, "little")
        frames.append(frame_of(profile, raw, clock))
    return frames


def raw_frames(profile: Path, samples: Iterable[AccelerationSample]) -> list[bytes]:
    """Return the frames that a sensor with the profile `RAW_PROFILE` would send."""
    layout = load_profile(profile)
    (field,) = layout.field
    return [
        frame_of(layout, {field.name: tuple(_count(v, field.scale) for v in s.acceleration_m_s2)})
        for s in samples
    ]


def _count(value: float, step: float) -> int:
    return _NO_VALUE if value != value else round(value / step)


def can_lines(frames: Iterable[CanFrameSample]) -> list[bytes]:
    """Return the lines that an slcan adapter would send."""
    return [frame_line(f.arbitration_id, f.data, extended=f.is_extended) for f in frames]


def depth_file(path: Path, frames: Sequence[DepthFrame]) -> None:
    """Write the images as an OpenNI recording, with microseconds since the first."""
    stamps_us = [(frame.t_ns - frames[0].t_ns) // 1000 for frame in frames]
    write_oni(path, [frame.depth_mm for frame in frames], stamps_us)


@contextmanager
def pumping(*pumps: Callable[[], bool]) -> Iterator[None]:
    """Call each pump again and again, while the context lasts, until it has nothing left."""
    stop = threading.Event()

    def pump() -> None:
        running = list(pumps)
        while not stop.wait(_PUMP_EVERY_S):
            running = [more for more in running if more()]

    thread = threading.Thread(target=pump, name="pump")
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


class SerialSender:
    """A sensor's end of a serial cable: sends frames as fast as they are read, when it is pumped.

    It is also the clock for a driver that identifies the sensor by a frame which is not kept.
    Opening the port throws away what came before, and a session first looks at its clock when the
    port is open: then the first frame is sent once more.
    """

    def __init__(self, endpoint: PtyEndpoint, frames: Sequence[bytes]) -> None:
        self._endpoint = endpoint
        self._greeting = frames[0]
        self._data = b"".join(frames)

    def clock_ns(self) -> int:
        """Return the monotonic clock; the first time, let a frame be heard."""
        greeting, self._greeting = self._greeting, b""
        if greeting:
            self._endpoint.write(greeting)
        return time.monotonic_ns()

    def pump(self) -> bool:
        """Send some, if all before was read; return whether there is more."""
        if not self._endpoint.unread():
            self._data = self._data[self._endpoint.write(self._data[:512]) :]
        return bool(self._data)
