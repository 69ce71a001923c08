"""The vibration sensor when its cable is pulled and put back."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from drivers.errors import DriverError
from drivers.source import OpenSource
from drivers.vibration.sensor import VibrationSensor
from tests.drivers.test_vibration_decode import MANUAL_FRAME
from tests.fakes.pty_endpoint import PtyEndpoint
from tests.fakes.serial_pty import FakeSerialDevice, Streamer, Wtvb01Slave
from tests.fakes.vibration_bench import (
    AFT601D_FRAMES,
    descriptors,
    vibrations,
)


@pytest.fixture
def port(tmp_path: Path) -> Path:
    return tmp_path / "ttySENSOR"


@pytest.mark.parametrize("profile", ["aft601d", "wtvb01-bt50", "wtvb01-485"])
def test_unplugging_while_reading_names_the_device(port: Path, profile: str) -> None:
    device = {"aft601d": Streamer(AFT601D_FRAMES), "wtvb01-bt50": Streamer([MANUAL_FRAME])}
    with FakeSerialDevice(port, device.get(profile, Wtvb01Slave())) as fake:
        sensor = VibrationSensor(str(port), profile, sleep=lambda _: None)
        with OpenSource(sensor):
            fake.unplug_after(3)
            with pytest.raises(DriverError, match=rf"{port}\): .* failed .*reconnect"):
                vibrations(sensor, 1000)
            with pytest.raises(DriverError, match=str(port)):
                sensor.read(0.1)
        with pytest.raises(DriverError, match="plug the device in"):
            sensor.open()
        fake.replug()
        with OpenSource(sensor):
            vibrations(sensor, 3)


def test_a_hundred_unpluggings_leak_nothing_and_take_no_time(port: Path) -> None:
    slowest_s = 0.0
    with FakeSerialDevice(port, Streamer(AFT601D_FRAMES)) as fake:
        sensor = VibrationSensor(str(port))
        sensor.open()
        before = descriptors()
        for _ in range(100):
            fake.unplug_after(2)
            with pytest.raises(DriverError, match=str(port)):
                vibrations(sensor, 1000)
            sensor.close()
            fake.replug()
            start_s = time.monotonic()
            sensor.open()
            vibrations(sensor, 1)
            slowest_s = max(slowest_s, time.monotonic() - start_s)
        assert descriptors() == before
        sensor.close()
    assert slowest_s < 2.0


def test_unplugging_before_the_identity_is_known_leaves_nothing_open(port: Path) -> None:
    before = descriptors()
    device = Streamer([b"noise"])
    with FakeSerialDevice(port, device) as fake:
        inside = descriptors()
        fake.unplug_after(3)
        with pytest.raises(DriverError, match=str(port)):
            VibrationSensor(str(port)).open()
        assert descriptors() == inside - 2  # the fake's own two
    assert descriptors() == before


def test_the_endpoint_drops_what_nobody_reads(port: Path) -> None:
    with PtyEndpoint(port) as endpoint:
        written = sum(endpoint.write(bytes(1000)) for _ in range(200))
        assert 1000 < written < 200_000
