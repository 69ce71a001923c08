"""A gyro driver, a faked bus and a register model, wired up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pytest

from drivers.gyro.chips import CHIPS
from drivers.gyro.yaw_gyro import STALL_BOUND_S, YawGyro
from drivers.samples import YawRateSample
from tests.fakes.fake_time import FakeTime
from tests.fakes.gyro_registers import MODELS, RegisterChip
from tests.fakes.i2c_ioctl import FakeI2c

PATH = "/dev/i2c-1"
FREE_RUNNING = ("l3gd20h", "itg3200", "mpu6050")


@dataclass
class Bench:
    """One chip on one faked bus, and the driver that talks to it."""

    time: FakeTime
    i2c: FakeI2c
    model: RegisterChip
    gyro: YawGyro

    def samples(self, count: int, timeout_s: float = 0.1) -> list[YawRateSample]:
        """Read that many samples; every read has to keep the stall bound."""
        found: list[YawRateSample] = []
        while len(found) < count:
            start_ns = self.time()
            found += self.gyro.read(timeout_s)
            assert self.time() - start_ns <= (timeout_s + STALL_BOUND_S) * 1e9
        return found


def gyro_bench(
    monkeypatch: pytest.MonkeyPatch,
    chip: str,
    *,
    rate_hz: float = 200.0,
    clock_error: float = 0.0,
    seed: int = 0,
) -> Bench:
    """Plug one chip in; the bus below smbus2 is faked until the test ends."""
    time = FakeTime()
    i2c = FakeI2c(time, seed=seed)
    i2c.install(monkeypatch)
    model = MODELS[chip](time, clock_error=clock_error)
    i2c.plug(PATH, CHIPS[chip].address, model)
    gyro = YawGyro(1, chip, rate_hz=rate_hz, clock=time, sleep=time.sleep)
    return Bench(time, i2c, model, gyro)


def bench_rate_hz(chip: str) -> float:
    """What the chip does when asked for 200 Hz."""
    return CHIPS[chip].output_rate_hz(200.0)


def gaps(samples: Sequence[YawRateSample]) -> int:
    """How many sequence numbers are missing."""
    return samples[-1].sequence - samples[0].sequence + 1 - len(samples)


def truly_lost(samples: Sequence[YawRateSample]) -> int:
    """How many samples of a free-running model are missing, by its own numbering."""
    return (counts(samples[-1]) - counts(samples[0])) % 2**15 + 1 - len(samples)


def counts(sample: YawRateSample) -> int:
    """Return the register value, which every live sample has."""
    assert sample.raw_counts is not None
    return sample.raw_counts
