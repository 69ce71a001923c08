"""The WTVB01-485 behind a pty: Modbus polling and the high-speed mode."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.errors import DriverError
from drivers.samples import AccelerationSample, VibrationSample
from drivers.source import OpenSource
from drivers.vibration.sensor import VibrationSensor
from tests.fakes.serial_pty import FakeSerialDevice, Wtvb01Slave
from tests.fakes.vibration_bench import (
    hasty_profile,
    vibrations,
)


@pytest.fixture
def port(tmp_path: Path) -> Path:
    return tmp_path / "ttySENSOR"


def test_the_485_is_identified_and_polled_in_its_real_chunks(port: Path) -> None:
    slave = Wtvb01Slave()
    slave.registers |= {0x36: 2048, 0x40: 2096, 0x41: 67, 0x44: 370, 0x32: 0x2A15, 0x33: 974}
    with FakeSerialDevice(port, slave, chunks=(32, 19)):
        sensor = VibrationSensor(str(port), "wtvb01-485", sleep=lambda _: None)
        with OpenSource(sensor) as opened:
            samples = sensor.read(2.0)
            assert sensor.statistics.polls.requests == 2
        assert opened.info is not None
    assert opened.info.details["device address"] == "50 03 02 00 50 45 b4"
    assert opened.info.details["detection cycle"] == "50 03 02 00 64 44 63"
    assert opened.info.produces == (VibrationSample, AccelerationSample)
    assert [request.hex(" ") for request in slave.requests] == [
        "50 03 00 1a 00 01 a8 4c",
        "50 03 00 65 00 01 99 94",
        "50 03 00 30 00 17 08 4a",
        "50 03 00 30 00 17 08 4a",
    ]
    vibration, force = samples
    assert isinstance(vibration, VibrationSample)
    assert isinstance(force, AccelerationSample)
    assert vibration.amplitude == pytest.approx([67e-6, 0, 0])
    assert vibration.frequency_hz == pytest.approx([37.0, 0, 0])
    assert vibration.temperature_c == pytest.approx(20.96)
    assert vibration.device_ticks == (21 * 60 + 42) * 1000 + 974
    assert force.acceleration_m_s2 == pytest.approx([0, 0, 9.80665])


@pytest.mark.parametrize(
    ("fault", "counter"),
    [
        ("silence", "silent"),
        ("exception", "exceptions"),
        ("wrong-slave", "wrong_slave"),
        ("corrupt", "damaged"),
        ("truncate", "damaged"),
    ],
)
def test_a_failed_poll_is_counted_and_repeated(
    port: Path, tmp_path: Path, fault: str, counter: str
) -> None:
    slave = Wtvb01Slave()
    with FakeSerialDevice(port, slave) as fake:
        sensor = VibrationSensor(
            str(port), hasty_profile(tmp_path, "wtvb01-485"), sleep=lambda _: None
        )
        with OpenSource(sensor):
            with fake.quiet():
                slave.faults += [fault, fault]
            vibrations(sensor, 1)
            polls = sensor.statistics.polls
            assert getattr(polls, counter) == 2
            assert polls.requests == 4
            with fake.quiet():
                slave.faults += [fault] * 4
            with pytest.raises(DriverError, match=rf"{port}\): 4 requests without an answer"):
                vibrations(sensor, 2)
            vibrations(sensor, 1)


def test_garbage_before_a_reply_does_not_spoil_it(port: Path) -> None:
    slave = Wtvb01Slave()
    with FakeSerialDevice(port, slave) as fake:
        sensor = VibrationSensor(str(port), "wtvb01-485", sleep=lambda _: None)
        with OpenSource(sensor):
            with fake.quiet():
                slave.faults += ["garbage-first"]
            vibrations(sensor, 2)
            assert sensor.statistics.polls.damaged == 0
            assert sensor.statistics.frames.garbage_bytes == 4


def test_a_reply_with_the_sync_inside_is_believed_when_nothing_follows(
    port: Path, tmp_path: Path
) -> None:
    slave = Wtvb01Slave()
    slave.registers |= {0x41: 0x5003, 0x42: 0x2E01, 0x43: 9}
    with FakeSerialDevice(port, slave) as fake:
        profile = hasty_profile(tmp_path, "wtvb01-485")
        sensor = VibrationSensor(str(port), profile, sleep=lambda _: None)
        with OpenSource(sensor):
            (sample, *_) = vibrations(sensor, 2)
            assert sample.amplitude == pytest.approx([0x5003 * 1e-6, 0x2E01 * 1e-6, 9e-6])
            with fake.quiet():
                slave.faults += ["truncate"]
            vibrations(sensor, 1)
            statistics = sensor.statistics
    assert statistics.polls.damaged == 1
    assert statistics.frames.garbage_bytes == 51 - 9, "the end of the burst ends what it began"
    assert statistics.frames.checksum_errors == 0


def test_a_device_of_another_address_is_refused(port: Path, tmp_path: Path) -> None:
    with (
        FakeSerialDevice(port, Wtvb01Slave(address=0x51)),
        pytest.raises(DriverError, match=r"device address: nothing came .* the device's address"),
    ):
        VibrationSensor(str(port), hasty_profile(tmp_path, "wtvb01-485")).open()


def test_the_high_speed_mode_is_entered_once_and_then_found(port: Path, tmp_path: Path) -> None:
    slave = Wtvb01Slave()
    slave.registers |= {0x47: 5, 0x48: -5, 0x49: 300}
    profile = hasty_profile(tmp_path, "wtvb01-485-fast")
    with FakeSerialDevice(port, slave):
        for opening in range(2):
            sensor = VibrationSensor(str(port), profile, sleep=lambda _: None)
            with OpenSource(sensor) as opened:
                (sample, *_) = vibrations(sensor, 20)
            assert opened.info is not None
            assert ("unlock" in opened.info.details) == (opening == 0)
            assert sample.amplitude == pytest.approx([5e-6, -5e-6, 300e-6])
            assert sample.statistic == "instantaneous"
            assert np.isnan(sample.frequency_hz).all()
    assert [request.hex(" ") for request in slave.requests] == [
        "50 06 00 69 b5 88 22 a1",
        "50 06 00 62 00 01 e4 55",
    ]
