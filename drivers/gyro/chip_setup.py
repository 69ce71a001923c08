"""Making a gyro chip ready: is it the chip, write its settings, do they hold."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from drivers.checks import check_positive
from drivers.errors import DriverError
from drivers.gyro.chips import GyroChip, Probe, Step
from drivers.gyro.i2c import I2cLink

RATE_TOLERANCE = 0.10


def possible_rate_hz(chip: GyroChip, wanted_hz: float) -> float:
    """Return the chip's rate, Hz, that is nearest to the wanted one.

    Raises:
        DriverError: not a rate, or off by more than RATE_TOLERANCE.
    """
    check_positive(f"{chip.model}: rate_hz", wanted_hz)
    rate_hz = chip.output_rate_hz(wanted_hz)
    if abs(rate_hz - wanted_hz) > RATE_TOLERANCE * wanted_hz:
        raise DriverError(
            f"{chip.model}: cannot do {wanted_hz:g} Hz; the nearest rate is {rate_hz:g} Hz"
        )
    return rate_hz


def check_identity(link: I2cLink, probe: Probe) -> None:
    """Raise DriverError unless the chip at this address can be the expected one."""
    found = link.read(probe.register, 1)[0]
    if found & probe.mask not in probe.allowed:
        allowed = " or ".join(f"0x{value:02x}" for value in probe.allowed)
        raise DriverError(
            f"{probe.meaning} (register 0x{probe.register:02x}) reads 0x{found:02x}, expected "
            f"{allowed} in the bits 0x{probe.mask:02x}; check chip and address"
        )


def set_up(link: I2cLink, steps: Sequence[Step], sleep: Callable[[float], None]) -> None:
    """Write the settings and read them back.

    Raises:
        DriverError: a setting does not hold.
        OSError: the bus failed.
    """
    for step in steps:
        if step.value is None:
            link.command(step.register)
        else:
            link.write(step.register, step.value)
        if step.settle_s:
            sleep(step.settle_s)
    for message in mismatches(link, steps):
        raise DriverError(message)


def mismatches(link: I2cLink, steps: Sequence[Step]) -> Iterator[str]:
    """Yield one line for each setting that does not read back as written."""
    for step in steps:
        if step.value is None or not step.check_mask:
            continue
        found = link.read(step.register, 1)[0]
        if (found ^ step.value) & step.check_mask:
            yield (
                f"register 0x{step.register:02x}: wrote 0x{step.value:02x}, read 0x{found:02x}; "
                "check the wiring and that this is the chip you named"
            )


def describe(steps: Sequence[Step]) -> str:
    """Return the settings that were read back, as register=value."""
    return " ".join(
        f"0x{step.register:02x}=0x{step.value:02x}"
        for step in steps
        if step.value is not None and step.check_mask
    )
