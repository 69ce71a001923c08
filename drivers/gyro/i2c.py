"""I2C through Linux i2c-dev: one repeated-start transfer, bounded retry, reopening the bus.

A transfer fails with OSError: the chip did not acknowledge (ENXIO, EREMOTEIO), the bus was held
low (ETIMEDOUT, the Raspberry Pi's answer to clock stretching), arbitration was lost (EAGAIN), or
the adapter itself is gone (ENODEV). None of these is rare on a vibrating rover, so every
transfer is tried a few times before the caller hears of it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from fcntl import ioctl
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from drivers.errors import DriverError

if TYPE_CHECKING:
    from smbus2 import SMBus, i2c_msg

# Linux uapi/linux/i2c-dev.h: the adapter's own time limit for one transfer, in units of 10 ms.
# The kernel default of 1 s would make any bound on a stall meaningless.
_I2C_TIMEOUT = 0x0702
_TRANSFER_LIMIT_10MS = 2
_FUNC_I2C = 0x1  # I2C_FUNC_I2C: the adapter can do plain transfers, not only SMBus ones


@runtime_checkable
class I2cBus(Protocol):
    """What a driver needs of an I2C bus."""

    def transfer(self, address: int, write: bytes, read_length: int) -> bytes:
        """Write, then read after a repeated start; with `read_length` 0 only write.

        Raises:
            OSError: not acknowledged, timed out, or the adapter is gone.
        """

    def close(self) -> None:
        """Release the bus; harmless when already released."""


class _LinuxI2cBus:
    """/dev/i2c-N through smbus2."""

    def __init__(self, bus: SMBus, message: type[i2c_msg]) -> None:
        self._bus = bus
        self._message = message

    def transfer(self, address: int, write: bytes, read_length: int) -> bytes:
        """Write, then read behind a repeated start, in one I2C_RDWR of the kernel."""
        message = self._message.write(address, write)
        if not read_length:
            self._bus.i2c_rdwr(message)
            return b""
        answer = self._message.read(address, read_length)
        self._bus.i2c_rdwr(message, answer)
        return bytes(answer)

    def close(self) -> None:
        """Close the device file."""
        self._bus.close()


def open_i2c(path: str) -> I2cBus:
    """Open an I2C device file such as /dev/i2c-1.

    Raises:
        DriverError: smbus2 is not installed, or the device file cannot be opened or cannot do
            plain I2C transfers; nothing stays open. The caller adds which device it was.
    """
    try:
        from smbus2 import SMBus, i2c_msg
    except ModuleNotFoundError as error:
        raise DriverError("smbus2 is not installed; pip install 'terravibe[gyro]'") from error
    bus = SMBus()
    try:
        _prepare(bus, path)
    except OSError as error:
        bus.close()
        raise DriverError(f"{error.strerror or error}; {_advice(error)}") from error
    return _LinuxI2cBus(bus, i2c_msg)


def _prepare(bus: SMBus, path: str) -> None:
    """Open the file and set the time limit; the caller closes on failure.

    Not SMBus(path): when its second ioctl fails, that constructor loses the descriptor.
    """
    bus.open(path)
    if bus.fd is None or not bus.funcs & _FUNC_I2C:
        raise OSError("this adapter speaks SMBus only")
    ioctl(bus.fd, _I2C_TIMEOUT, _TRANSFER_LIMIT_10MS)


def _advice(error: OSError) -> str:
    """Say what usually helps."""
    if isinstance(error, FileNotFoundError):
        return "enable the bus (dtparam=i2c_arm=on) and load i2c-dev"
    if isinstance(error, PermissionError):
        return "add the user to the group i2c"
    return "check that an I2C adapter is plugged in there"


@dataclass(slots=True)
class LinkCounters:
    """What went wrong on the bus since construction.

    Attributes:
        failed_transfers: transfers that were not acknowledged or timed out.
        reopened: times that the bus was opened again after a failure.
    """

    failed_transfers: int = 0
    reopened: int = 0


class I2cLink:
    """One chip on one bus: register access with bounded retry.

    Args:
        bus: device file, number of /dev/i2c-N, or a bus that the caller owns and closes.
        address: 7-bit address of the chip.
        clock: CLOCK_MONOTONIC in nanoseconds.
        sleep: waits that many seconds.
    """

    ATTEMPTS = 6
    BACKOFF_S = 0.0005

    def __init__(
        self,
        bus: int | str | I2cBus,
        address: int,
        *,
        clock: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._given = f"/dev/i2c-{bus}" if isinstance(bus, int) else bus
        self._bus: I2cBus | None = None
        self._address = address
        self._clock = clock
        self._sleep = sleep
        self.counters = LinkCounters()
        self.give_up_ns: int | None = None

    @property
    def label(self) -> str:
        """Where the chip is, for messages."""
        where = self._given if isinstance(self._given, str) else "the given bus"
        return f"0x{self._address:02x} on {where}"

    @property
    def is_open(self) -> bool:
        """Whether a bus is held."""
        return self._bus is not None

    def open(self) -> None:
        """Take hold of the bus; DriverError when it cannot be opened."""
        self._bus = open_i2c(self._given) if isinstance(self._given, str) else self._given

    def reopen(self) -> None:
        """Release the bus and take hold of it again; DriverError when it cannot be opened."""
        self.close()
        self.open()
        self.counters.reopened += 1

    def close(self) -> None:
        """Release the bus if it was opened here."""
        bus, self._bus = self._bus, None
        if bus is not None and isinstance(self._given, str):
            with suppress(OSError):  # an adapter that is gone cannot be closed any better
                bus.close()

    def read(self, register: int, length: int) -> bytes:
        """Read `length` bytes from `register`; OSError after the last attempt."""
        return self._transfer(bytes([register]), length)

    def write(self, register: int, value: int) -> None:
        """Write one register; OSError after the last attempt."""
        self._transfer(bytes([register, value]), 0)

    def command(self, register: int) -> None:
        """Send a register address without data; OSError after the last attempt."""
        self._transfer(bytes([register]), 0)

    def _transfer(self, write: bytes, read_length: int) -> bytes:
        """Try up to ATTEMPTS times, never past `give_up_ns`.

        All transfers of these chips are safe to repeat.
        """
        if self._bus is None:
            raise DriverError(f"{self.label}: not open; call open() first")
        attempts_left = self.ATTEMPTS
        while True:
            try:
                return self._bus.transfer(self._address, write, read_length)
            except OSError:
                self.counters.failed_transfers += 1
                attempts_left -= 1
                if not attempts_left or self._is_late():
                    raise
            self._sleep(self.BACKOFF_S)

    def _is_late(self) -> bool:
        return self.give_up_ns is not None and self._clock() >= self.give_up_ns
