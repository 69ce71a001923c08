"""The gyro driver on a bus that fails, sticks, disappears, or browns the chip out."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from functools import partial

import pytest

from drivers.errors import DriverError
from drivers.gyro.chips import CHIPS
from drivers.gyro.yaw_gyro import STALL_BOUND_S
from drivers.samples import YawRateSample
from drivers.source import OpenSource
from tests.fakes.gyro_bench import (
    FREE_RUNNING,
    PATH,
    Bench,
    bench_rate_hz,
    gaps,
    gyro_bench,
    truly_lost,
)

MakeBench = Callable[..., Bench]


@pytest.fixture
def make_bench(monkeypatch: pytest.MonkeyPatch) -> MakeBench:
    return partial(gyro_bench, monkeypatch)


@pytest.mark.parametrize("chip", CHIPS)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_storm_of_failing_transfers_costs_no_more_than_it_explains(
    chip: str, seed: int, make_bench: MakeBench
) -> None:
    bench = make_bench(chip, seed=seed)
    with OpenSource(bench.gyro):
        bench.i2c.fail_ratio = 0.30
        samples = bench.samples(3000)
    failures_ns = bench.i2c.failures_ns
    assert len(failures_ns) > 0.3 * 3000
    period_ns = 1e9 / bench_rate_hz(chip)
    for a, b in itertools.pairwise(samples):
        missing = b.sequence - a.sequence - 1
        failures = sum(a.t_ns < t_ns <= b.t_ns for t_ns in failures_ns) if missing else 0
        # One failed attempt costs its transfer and the pause after it, 0.7 ms at most; giving a
        # transfer up costs the check of all settings besides, 8 ms.
        explained_ns = failures * 0.7e6 + (failures // 6) * 8e6
        assert missing * period_ns <= explained_ns
    if chip in FREE_RUNNING:
        assert truly_lost(samples) - gaps(samples) in range(5)
        assert truly_lost(samples) <= 0.01 * len(samples)
    assert bench.gyro.counters.set_up_again == 0
    assert bench.gyro.faults.mended["failed_transfers"] >= len(failures_ns)


@pytest.mark.parametrize("chip", CHIPS)
def test_a_stuck_bus_is_reported_within_the_bound(chip: str, make_bench: MakeBench) -> None:
    bench = make_bench(chip)
    with OpenSource(bench.gyro):
        bench.samples(5)
        bench.i2c.stuck = True
        for _ in range(5):
            start_ns = bench.time()
            with pytest.raises(DriverError, match=r"gyro: .* on /dev/i2c-1: "):
                bench.gyro.read(0.1)
            assert bench.time() - start_ns <= (0.1 + STALL_BOUND_S) * 1e9
        bench.i2c.stuck = False
        assert len(bench.samples(5)) == 5


@pytest.mark.parametrize("chip", CHIPS)
def test_unplugging_is_named_and_replugging_is_used_again(chip: str, make_bench: MakeBench) -> None:
    bench = make_bench(chip)
    sequence = -1
    with OpenSource(bench.gyro):
        for _ in range(100):
            sequence = check_sequence(bench.samples(3), sequence)
            chips = bench.i2c.unplug(PATH)
            with pytest.raises(DriverError, match=r"gyro: .* at 0x6\w on /dev/i2c-1: "):
                bench.samples(1)
            bench.model.power_cycle()
            bench.i2c.adapters[PATH] = chips
            replugged_ns = bench.time()
            first = bench.samples(1)
            assert first[0].t_ns - replugged_ns <= 2e9
            sequence = check_sequence(first, sequence)
            assert bench.i2c.open_descriptors == 1
    assert bench.i2c.open_descriptors == 0
    assert bench.gyro.counters.set_up_again == 100


def check_sequence(samples: Sequence[YawRateSample], last: int) -> int:
    for sample in samples:
        assert sample.sequence > last
        last = sample.sequence
    return last


@pytest.mark.parametrize("chip", CHIPS)
def test_a_chip_that_lost_its_settings_is_set_up_again(chip: str, make_bench: MakeBench) -> None:
    bench = make_bench(chip)
    with OpenSource(bench.gyro):
        bench.samples(10)
        bench.model.power_cycle()
        after = bench.samples(10)
    assert bench.gyro.counters.set_up_again == 1
    assert bench.gyro.faults.mended["set_up_again"] == 1
    assert after[-1].rate_rad_s != 0.0


def test_a_chip_that_never_has_a_sample_is_an_error(make_bench: MakeBench) -> None:
    bench = make_bench("mpu6050")
    with OpenSource(bench.gyro):
        bench.samples(3)
        bench.model.halted = True
        with pytest.raises(DriverError, match="answers but has no new samples"):
            bench.samples(1)
        bench.model.halted = False
        assert bench.samples(3)
    assert bench.gyro.counters.set_up_again >= 1
