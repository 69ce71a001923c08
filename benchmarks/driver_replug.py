"""Pull and put back the cable of each faked device while its driver reads."""

from __future__ import annotations

import importlib.util
import os
import signal
import statistics
import struct
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from drivers.depth.openni_depth import OpenNiDepth
from drivers.errors import DriverError
from drivers.mocap.motion_capture import MotionCapture
from drivers.samples import Sample
from drivers.source import Source
from drivers.vibration.sensor import VibrationSensor
from drivers.wheels.can_wheels import Wheels
from tests.drivers.test_vibration_decode import MANUAL_FRAME
from tests.fakes import gyro_bench
from tests.fakes.serial_pty import FakeSerialDevice, Streamer, Wtvb01Slave
from tests.fakes.slcan_pty import SlcanPty, frame_line
from tests.fakes.vibration_bench import AFT601D_FRAMES, descriptors

_STUB = Path(__file__).parents[1] / "tests" / "fakes" / "motioncapture_stub"
_PATIENCE_S = 10.0


@dataclass(frozen=True, slots=True)
class Cable:
    """A device that is plugged in, its driver, and how to part them.

    Attributes:
        label: what an error must contain to name the device.
        source: the driver.
        unplug: takes the device away.
        replug: puts it back.
        pump: called before each read, for a fake that has no thread of its own.
        now_s: the clock that the recovery is taken by; the gyro's bench has its own.
    """

    label: str
    source: Source
    unplug: Callable[[], object]
    replug: Callable[[], object]
    pump: Callable[[], object] = lambda: None
    now_s: Callable[[], float] = time.monotonic

    def samples(self) -> Sequence[Sample]:
        """Read until samples come.

        Raises:
            DriverError: of the driver, or none came in 10 s.
        """
        end_s = time.monotonic() + _PATIENCE_S
        while time.monotonic() < end_s:
            self.pump()
            if samples := self.source.read(0.1):
                return samples
        raise DriverError(f"nothing in {_PATIENCE_S} s")


@dataclass(frozen=True, slots=True)
class Replugging:
    """What the cycles came to; times, in s, are from replugging to the first sample."""

    device: str
    cycles: int
    named: int
    median_s: float
    slowest_s: float
    descriptors_before: int
    descriptors_after: int


def replug(device: str, cable: Cable, cycles: int) -> Replugging:
    """Unplug while reading, wait for the error, replug, close, open, read; so many times."""
    cable.source.open()
    cable.samples()
    before = descriptors()
    named, times_s = 0, []
    for _ in range(cycles):
        cable.unplug()
        named += cable.label in _error_of(cable)
        cable.source.close()
        cable.replug()
        begun_s = cable.now_s()
        cable.source.open()
        cable.samples()
        times_s.append(cable.now_s() - begun_s)
    after = descriptors()
    cable.source.close()
    return Replugging(
        device, cycles, named, statistics.median(times_s), max(times_s), before, after
    )


def _error_of(cable: Cable) -> str:
    """Read until the driver complains, and return its words."""
    end_s = time.monotonic() + _PATIENCE_S
    while time.monotonic() < end_s:
        try:
            cable.source.read(0.1)
        except DriverError as error:
            return str(error)
    return ""


def kill_children() -> None:
    """Kill the processes that this one has started: the helper of a driver that is open."""
    for children in Path("/proc/self/task").glob("*/children"):
        for pid in children.read_text().split():
            os.kill(int(pid), signal.SIGKILL)


def _serial(profile: str, folder: Path, stack: ExitStack) -> Cable:
    port = folder / f"tty-{profile}"
    behaviour = {"aft601d": Streamer(AFT601D_FRAMES), "wtvb01-bt50": Streamer([MANUAL_FRAME])}
    fake = stack.enter_context(FakeSerialDevice(port, behaviour.get(profile, Wtvb01Slave())))
    sensor = VibrationSensor(str(port), profile)
    return Cable(str(port), sensor, lambda: fake.unplug_after(1), fake.replug)


def _gyro(chip: str, _folder: Path, stack: ExitStack) -> Cable:
    bench = gyro_bench.gyro_bench(stack.enter_context(pytest.MonkeyPatch.context()), chip)
    path, taken = gyro_bench.PATH, dict(bench.i2c.adapters)

    def put_back() -> None:
        """Plug the chip in, which lost its settings."""
        bench.model.power_cycle()
        bench.i2c.adapters[path] = taken[path]

    def unplug() -> None:
        bench.i2c.unplug(path)

    return Cable(path, bench.gyro, unplug, put_back, now_s=lambda: bench.time() / 1e9)


def _wheels(_kind: str, folder: Path, stack: ExitStack) -> Cable:
    adapter = stack.enter_context(SlcanPty(folder / "ttyCAN"))
    wheels = Wheels(str(adapter.path), interface="slcan", bus_options={"sleep_after_open": 0})
    line = frame_line(0x02021542, struct.pack("<i", 65536), extended=True)

    def send() -> None:
        """Let the bus carry a frame, where somebody listens."""
        if adapter.plugged and adapter.is_streaming:
            adapter.feed([line])
            adapter.pump()

    return Cable(str(adapter.path), wheels, adapter.unplug, adapter.replug, send)


def _openni(_kind: str, _folder: Path, _stack: ExitStack) -> Cable:
    return Cable("Dummy", OpenNiDepth(device="Dummy"), kill_children, lambda: None)


def _mocap(_kind: str, _folder: Path, stack: ExitStack) -> Cable:
    patch = stack.enter_context(pytest.MonkeyPatch.context())
    patch.setenv("PYTHONPATH", os.pathsep.join([str(_STUB), *sys.path]))
    patch.setattr(importlib.util, "find_spec", lambda _name: object())
    source = MotionCapture("rover", system="stub", options={"frames": 10**9, "then": "hang"})
    return Cable("mocap: stub", source, kill_children, lambda: None)


_MAKERS: dict[str, Callable[[str, Path, ExitStack], Cable]] = {
    "vibration aft601d": _serial,
    "vibration wtvb01-bt50": _serial,
    "vibration wtvb01-485": _serial,
    "gyro xv7001bb": _gyro,
    "gyro mpu6050": _gyro,
    "wheels slcan": _wheels,
    "openni Dummy": _openni,
    "mocap stub": _mocap,
}


@contextmanager
def _cable(device: str, folder: Path) -> Iterator[Cable]:
    with ExitStack() as stack:
        yield _MAKERS[device](device.split()[1], folder, stack)


def replug_all(cycles: int, folder: Path) -> Iterator[Replugging]:
    """Yield the figures of each device; the ports of the fakes are made in `folder`."""
    for device in _MAKERS:
        with _cable(device, folder) as cable:
            yield replug(device, cable, cycles)
