"""The gyro driver's conversation with each chip, over unmodified smbus2 on a faked i2c-dev."""

from __future__ import annotations

import errno
import itertools
import math
import sys
from collections.abc import Callable
from functools import partial

import pytest

from drivers.errors import DriverError
from drivers.gyro.chips import CHIPS
from drivers.gyro.yaw_gyro import YawGyro
from drivers.samples import YawRateSample
from drivers.source import OpenSource, make_source
from tests.fakes.fake_time import FakeTime
from tests.fakes.gyro_bench import (
    FREE_RUNNING,
    Bench,
    bench_rate_hz,
    counts,
    gaps,
    gyro_bench,
    truly_lost,
)
from tests.fakes.gyro_registers import EpsonXv, L3gd20h
from tests.fakes.i2c_ioctl import FUNC_SMBUS_BYTE_DATA

MakeBench = Callable[..., Bench]


@pytest.fixture
def make_bench(monkeypatch: pytest.MonkeyPatch) -> MakeBench:
    return partial(gyro_bench, monkeypatch)


@pytest.mark.parametrize("chip", CHIPS)
def test_open_identifies_and_read_delivers(chip: str, make_bench: MakeBench) -> None:
    bench = make_bench(chip)
    with OpenSource(bench.gyro) as source:
        assert source.info is not None
        assert source.info.model == CHIPS[chip].model
        assert source.info.produces == (YawRateSample,)
        assert source.info.time_base == "monotonic"
        assert "0x6" in source.info.details["i2c"]
        samples = bench.samples(50)
    assert [s.sequence for s in samples] == list(range(50))
    assert all(a.t_ns < b.t_ns for a, b in itertools.pairwise(samples))
    last = samples[-1]
    scale = CHIPS[chip].deg_s_per_count
    assert last.rate_rad_s == pytest.approx(math.radians(counts(last) * scale))
    expected_c = {"l3gd20h": None, "itg3200": 35.0, "mpu6050": 36.53}.get(chip, 25.0)
    assert last.temperature_c == pytest.approx(expected_c)
    assert bench.i2c.open_descriptors == 0


def test_epson_set_up_is_the_sequence_of_the_data_sheet(make_bench: MakeBench) -> None:
    bench = make_bench("xv7001bb")
    bench.gyro.open()
    sent = [data.hex() for _, data in bench.i2c.writes]
    # StsRd; SWRst, SlpOut, OutCtl1 = 24 bit on, DspCtl2 = 70 Hz, TsDataFormat = 12 bit, DspRes;
    # then the three settings are read back.
    assert sent == ["04", "09", "06", "0b05", "0204", "1c4b", "0d", "0b", "02", "1c"]
    assert isinstance(bench.model, EpsonXv)
    assert not bench.model.zeroed, "AutoC is only allowed at standstill"
    bench.gyro.close()


@pytest.mark.parametrize("chip", FREE_RUNNING)
@pytest.mark.parametrize("clock_error", [-0.04, 0.0, 0.04])
def test_no_sample_is_missed_or_read_twice(
    chip: str, clock_error: float, make_bench: MakeBench
) -> None:
    bench = make_bench(chip, clock_error=clock_error)
    with OpenSource(bench.gyro):
        samples = bench.samples(2000)
    steps = {counts(b) - counts(a) for a, b in itertools.pairwise(samples)}
    assert steps == {1}
    assert gaps(samples) == 0
    assert bench.gyro.counters.lost_samples == 0


@pytest.mark.parametrize(("chip", "rate_hz"), [("mpu6050", 1000.0), ("l3gd20h", 757.6)])
def test_the_highest_rates_lose_nothing(chip: str, rate_hz: float, make_bench: MakeBench) -> None:
    bench = make_bench(chip, rate_hz=rate_hz)
    with OpenSource(bench.gyro):
        samples = bench.samples(3000)
    assert truly_lost(samples) == 0


def test_a_chip_without_data_ready_is_paced_by_the_clock(make_bench: MakeBench) -> None:
    bench = make_bench("xv7021bb", rate_hz=400.0)
    with OpenSource(bench.gyro):
        samples = bench.samples(1000)
    elapsed_s = (samples[-1].t_ns - samples[0].t_ns) / 1e9
    assert elapsed_s == pytest.approx(999 / 400.0, abs=1e-3)
    assert gaps(samples) == 0


@pytest.mark.parametrize("chip", CHIPS)
def test_a_late_reader_sees_the_gap_in_the_sequence(chip: str, make_bench: MakeBench) -> None:
    bench = make_bench(chip)
    with OpenSource(bench.gyro):
        before = bench.samples(1)[0]
        bench.time.advance(0.5)
        after = bench.samples(1)[0]
    periods = (after.t_ns - before.t_ns) * bench_rate_hz(chip) / 1e9
    assert after.sequence - before.sequence == pytest.approx(periods, abs=2)
    if chip in FREE_RUNNING:
        lost = after.sequence - before.sequence - 1
        assert 0 <= (counts(after) - counts(before) - 1) - lost <= 1
        assert bench.gyro.counters.lost_samples == lost
    assert bench.gyro.counters.overruns == (1 if chip == "l3gd20h" else 0)


def test_read_returns_nothing_before_the_next_sample(make_bench: MakeBench) -> None:
    bench = make_bench("mpu6050", rate_hz=4.0)
    with OpenSource(bench.gyro):
        bench.samples(1)
        start_ns = bench.time()
        assert bench.gyro.read(0.01) == ()
        assert bench.time() - start_ns == pytest.approx(0.01e9, rel=0.01)


# --- what `open` refuses -------------------------------------------------------------------------


def test_another_chip_is_refused(make_bench: MakeBench) -> None:
    bench = make_bench("mpu6050")
    bench.model.registers[0x75] = 0x70
    with pytest.raises(DriverError, match=r"WHO_AM_I \(register 0x75\) reads 0x70, expected 0x68"):
        bench.gyro.open()
    assert bench.i2c.open_descriptors == 0


def test_a_bus_that_reads_ones_is_no_epson_chip(make_bench: MakeBench) -> None:
    bench = make_bench("xv7011bb")
    assert isinstance(bench.model, EpsonXv)
    bench.model.state = 0x07
    with pytest.raises(DriverError, match=r"state \(register 0x04\) reads 0x0f"):
        bench.gyro.open()


@pytest.mark.parametrize("chip", CHIPS)
def test_a_setting_that_does_not_hold_is_named(chip: str, make_bench: MakeBench) -> None:
    bench = make_bench(chip)
    step = next(s for s in CHIPS[chip].set_up(bench_rate_hz(chip)) if s.value and s.check_mask)
    bench.model.stuck_registers[step.register] = 0x00
    message = rf"register 0x{step.register:02x}: wrote 0x{step.value:02x}, read 0x00"
    with pytest.raises(DriverError, match=message):
        bench.gyro.open()
    assert bench.i2c.open_descriptors == 0


def test_nothing_at_the_address(make_bench: MakeBench) -> None:
    bench = make_bench("l3gd20h")
    gyro = YawGyro(1, "l3gd20h", 0x6A, clock=bench.time, sleep=bench.time.sleep)
    with pytest.raises(DriverError, match=r"L3GD20H .* at 0x6a on /dev/i2c-1: .*Remote I/O error"):
        gyro.open()
    assert bench.i2c.open_descriptors == 0


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (FileNotFoundError(errno.ENOENT, "No such file"), "enable the bus"),
        (PermissionError(errno.EACCES, "Permission denied"), "group i2c"),
        (OSError(errno.ENXIO, "No such device or address"), "plugged in"),
    ],
)
def test_a_bus_that_cannot_be_opened_says_what_to_do(
    error: OSError, message: str, make_bench: MakeBench
) -> None:
    bench = make_bench("mpu6050")
    bench.i2c.open_error = error
    with pytest.raises(DriverError, match=message):
        bench.gyro.open()


def test_an_adapter_without_plain_i2c_is_refused_and_closed(make_bench: MakeBench) -> None:
    bench = make_bench("mpu6050")
    bench.i2c.functions = FUNC_SMBUS_BYTE_DATA
    with pytest.raises(DriverError, match="SMBus only"):
        bench.gyro.open()
    assert bench.i2c.open_descriptors == 0


def test_the_adapter_time_limit_is_shortened(make_bench: MakeBench) -> None:
    bench = make_bench("mpu6050")
    with OpenSource(bench.gyro):
        assert bench.i2c.timeout_10ms == 2


def test_a_missing_library_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "smbus2", None)
    with pytest.raises(DriverError, match=r"pip install 'terravibe\[gyro\]'"):
        YawGyro().open()


def test_an_unknown_chip_lists_the_known_ones() -> None:
    with pytest.raises(DriverError, match="no gyro chip 'bno055'; expected one of xv7001bb"):
        make_source("gyro", chip="bno055")


class HandedInBus:
    """A bus that belongs to the test."""

    def __init__(self, chip: L3gd20h) -> None:
        self.chip = chip
        self.closed = False

    def transfer(self, address: int, write: bytes, read_length: int) -> bytes:
        assert address == 0x6B
        self.chip.time.advance(100e-6)
        self.chip.write(write)
        return self.chip.read(read_length)

    def close(self) -> None:
        self.closed = True


def test_a_bus_can_be_handed_in_and_stays_the_callers() -> None:
    time = FakeTime()
    bus = HandedInBus(L3gd20h(time))
    gyro = YawGyro(bus, "l3gd20h", clock=time, sleep=time.sleep)
    with OpenSource(gyro):
        assert len([gyro.read(0.1) for _ in range(5)]) == 5
    assert not bus.closed
