"""The vibration sensor behind a pty, through the real pyserial: streams and identity."""

from __future__ import annotations

import itertools
import sys
from pathlib import Path

import pytest

from drivers.errors import DriverError
from drivers.faults import NO_FAULTS
from drivers.samples import VibrationSample
from drivers.source import OpenSource, make_source
from drivers.vibration.acceleration import acceleration_m_s2
from drivers.vibration.sensor import VibrationSensor, probe_port
from tests.drivers.test_vibration_decode import MANUAL_FRAME
from tests.fakes.serial_pty import FakeSerialDevice, Streamer, Wtvb01Slave
from tests.fakes.vibration_bench import (
    AFT601D_FRAMES,
    PROFILE_FOLDER,
    hasty_profile,
    vibrations,
)


@pytest.fixture
def port(tmp_path: Path) -> Path:
    return tmp_path / "ttySENSOR"


# --- streams ------------------------------------------------------------------------------------


def test_the_assumed_aft601d_streams(port: Path) -> None:
    with FakeSerialDevice(port, Streamer(AFT601D_FRAMES)):
        sensor = VibrationSensor(str(port))
        with OpenSource(sensor) as opened:
            samples = vibrations(sensor, 50)
        assert opened.info is not None
    assert opened.info.model == "AFT601D (assumed layout)"
    assert opened.info.details["layout"] == "assumed, not verified"
    assert opened.info.details["band Hz"] == "5 to 500"
    assert opened.info.produces == (VibrationSample,)
    assert opened.info.nominal_rate_hz == {VibrationSample: 100.0}
    assert [s.sequence for s in samples] == list(range(len(samples)))
    assert all(a.t_ns < b.t_ns for a, b in itertools.pairwise(samples))
    assert isinstance(samples[0].t_ns, int)
    assert samples[0].amplitude / samples[0].amplitude[0] == pytest.approx([1, 2, 3])
    assert samples[0].frequency_hz == pytest.approx([37.0, 37.1, 37.2])


def test_the_bt50_streams_and_its_tone_has_an_acceleration(port: Path) -> None:
    with FakeSerialDevice(port, Streamer([MANUAL_FRAME]), chunks=(5, 11)):
        sensor = VibrationSensor(str(port), "wtvb01-bt50")
        with OpenSource(sensor):
            (sample, *_) = vibrations(sensor, 1)
    a = acceleration_m_s2(
        sample.amplitude, sample.frequency_hz, sample.quantity, sample.statistic, (5.0, 100.0)
    )
    assert a[0] == pytest.approx(3.62, abs=0.005)


def test_garbage_between_the_frames_is_counted(port: Path) -> None:
    device = Streamer(AFT601D_FRAMES)
    with FakeSerialDevice(port, device) as fake:
        sensor = VibrationSensor(str(port))
        with OpenSource(sensor):
            before, met = sensor.statistics.frames, sensor.faults
            with fake.quiet():
                device.garbage = b"\xaa\x55 not a frame"
            vibrations(sensor, 40)
            after, faults = sensor.statistics.frames, sensor.faults.since(met)
    assert after.resyncs == before.resyncs + 1
    assert after.garbage_bytes == before.garbage_bytes + 14
    assert after.checksum_errors == before.checksum_errors + 1
    assert faults.losses() == ["1 checksum errors", "14 garbage bytes", "1 resyncs"]
    assert sensor.faults == NO_FAULTS, "closed"


def test_a_batch_is_stamped_once_and_dated_back(port: Path) -> None:
    clock_ns = itertools.count(10**9, 1_000_000)
    pause_ns = 0
    with FakeSerialDevice(port, Streamer(AFT601D_FRAMES)) as fake:
        sensor = VibrationSensor(str(port), clock_ns=lambda: next(clock_ns) + pause_ns)
        with OpenSource(sensor), fake.quiet() as endpoint:
            while sensor.read(0.0):
                pass
            endpoint.write(b"".join(AFT601D_FRAMES[:5]))
            pause_ns = 10**9
            start_ns = next(clock_ns) + pause_ns
            samples = sensor.read(0.1)
    assert len(samples) == 5
    # The clock was read for the deadline, for the wait, and then right after the read.
    last_ns = start_ns + 3_000_000
    assert [s.t_ns for s in samples] == [last_ns - 10_000_000 * n for n in (4, 3, 2, 1, 0)]


def test_a_silent_stream_gives_nothing_in_time(port: Path) -> None:
    device = Streamer(AFT601D_FRAMES)
    with FakeSerialDevice(port, device) as fake:
        sensor = VibrationSensor(str(port))
        with OpenSource(sensor):
            with fake.quiet():
                device.silent = True
            while sensor.read(0.02):
                pass
            assert sensor.read(0.0) == []


def test_stop_steps_are_sent_at_the_end(port: Path, tmp_path: Path) -> None:
    text = (PROFILE_FOLDER / "aft601d.toml").read_text()
    stop = '[[stop]]\nwhat = "stop"\nsend = "01 02 03"\n\n'
    (tmp_path / "stoppable.toml").write_text(text.replace("[frame]\n", stop + "[frame]\n"))
    device = Streamer(AFT601D_FRAMES)
    with FakeSerialDevice(port, device) as fake:
        sensor = VibrationSensor(str(port), tmp_path / "stoppable.toml")
        with OpenSource(sensor):
            vibrations(sensor, 3)
        with fake.quiet() as endpoint:
            assert device.received + endpoint.read() == b"\x01\x02\x03"


# --- identity -----------------------------------------------------------------------------------


def test_silence_is_no_sensor(port: Path, tmp_path: Path) -> None:
    device = Streamer(AFT601D_FRAMES)
    device.silent = True
    with FakeSerialDevice(port, device):
        sensor = VibrationSensor(str(port), hasty_profile(tmp_path, "aft601d"))
        with pytest.raises(DriverError, match=rf"{port}\): silence and no frame .* 115200 baud"):
            sensor.open()
        device.silent = False
        with OpenSource(sensor):  # the failed open kept nothing
            vibrations(sensor, 1)


def test_bytes_of_another_layout_are_no_sensor(port: Path, tmp_path: Path) -> None:
    with (
        FakeSerialDevice(port, Streamer([MANUAL_FRAME])),
        pytest.raises(DriverError, match=r"\d+ bytes and no frame"),
    ):
        VibrationSensor(str(port), hasty_profile(tmp_path, "aft601d")).open()


def test_a_port_that_is_open_elsewhere_is_refused(port: Path) -> None:
    with FakeSerialDevice(port, Streamer(AFT601D_FRAMES)):
        first, second = VibrationSensor(str(port)), VibrationSensor(str(port))
        with OpenSource(first):
            with pytest.raises(DriverError, match="stop the other program"):
                second.open()
            vibrations(first, 3)


def test_a_port_that_is_absent_is_refused(port: Path) -> None:
    with pytest.raises(DriverError, match=rf"{port}\): opening failed .* plug the device in"):
        VibrationSensor(str(port)).open()


def test_a_missing_library_is_named_with_its_extra(
    port: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "serial", None)
    with pytest.raises(DriverError, match=r"pip install 'terravibe\[vibration\]'"):
        VibrationSensor(str(port)).open()


def test_constructing_touches_nothing_and_closing_twice_is_harmless() -> None:
    sensor = make_source("vibration", port="/no/such/port", profile="no such profile")
    assert sensor.name == "vibration"
    with pytest.raises(DriverError, match="is not open; call open"):
        sensor.read(0.1)
    sensor.close()
    sensor.close()


def test_probing_tells_which_profile_answers(port: Path, tmp_path: Path) -> None:
    names = ["aft601d", "wtvb01-bt50", "wtvb01-485", "wtvb01-485-fast"]
    profiles = [hasty_profile(tmp_path, name) for name in names]
    with FakeSerialDevice(port, Streamer([MANUAL_FRAME])):
        assert list(probe_port(str(port), profiles).values()) == [False, True, False, False]
    slave = Wtvb01Slave()
    with FakeSerialDevice(port, slave):
        assert list(probe_port(str(port), profiles).values()) == [False, False, True, False]
    assert not slave.high_speed, "probing must not change the device"
