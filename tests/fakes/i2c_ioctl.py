"""Linux i2c-dev faked below unmodified smbus2, at os.open, os.close and ioctl.

smbus2's own ctypes structures are built by smbus2 and taken apart here, as the kernel would.
Descriptors are real ones (of /dev/null), so that a leak shows in /proc/self/fd.

Not simulated: the wires (clock stretching, arbitration, bus speed negotiation; a stuck bus is
only its time-out), bytes flipped in an acknowledged transfer, SMBus calls, 10-bit addresses, a
chip that a kernel driver already holds, and I2C_RDWR messages that a signal interrupts.
"""

from __future__ import annotations

import ctypes
import errno
import os
import random
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, Protocol

import pytest

from tests.fakes.fake_time import FakeTime

I2C_FUNCS, I2C_RDWR, I2C_TIMEOUT = 0x0705, 0x0707, 0x0702
I2C_M_RD = 0x0001
FUNC_I2C, FUNC_SMBUS_BYTE_DATA = 0x1, 0x00180000

_BYTE_S = 9 / 400e3
_TRANSFER_S = 60e-6


class FakeChip(Protocol):
    """A chip as the bus sees it."""

    def acknowledges(self) -> bool:
        """Whether it answers to its address now."""

    def write(self, data: bytes) -> None:
        """Take the bytes of one write message."""

    def read(self, length: int) -> bytes:
        """Return the bytes of one read message."""


class FakeI2c:
    """Adapters by path, chips by address, faults by seed."""

    def __init__(self, time: FakeTime, *, seed: int = 0) -> None:
        self.time = time
        self.adapters: dict[str, dict[int, FakeChip]] = {}
        self.functions = FUNC_I2C | FUNC_SMBUS_BYTE_DATA
        self.fail_ratio = 0.0
        self.stuck = False
        self.open_error: OSError | None = None
        self.failures_ns: list[int] = []
        self.writes: list[tuple[int, bytes]] = []
        self.timeout_10ms = 100  # the kernel's default
        self._random = random.Random(seed)
        self._paths: dict[int, str] = {}

    def install(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Put this below smbus2 and below the driver's own ioctl."""
        shim = SimpleNamespace(open=self.open, close=self.close, O_RDWR=os.O_RDWR)
        monkeypatch.setattr("smbus2.smbus2.os", shim)
        monkeypatch.setattr("smbus2.smbus2.ioctl", self.ioctl)
        monkeypatch.setattr("drivers.gyro.i2c.ioctl", self.ioctl)

    def plug(self, path: str, address: int, chip: FakeChip) -> None:
        """Connect a chip; the adapter appears with its first chip."""
        self.adapters.setdefault(path, {})[address] = chip

    def unplug(self, path: str) -> dict[int, FakeChip]:
        """Remove the adapter with its chips; open descriptors of it go dead."""
        return self.adapters.pop(path)

    @property
    def open_descriptors(self) -> int:
        """How many descriptors of adapters are open."""
        return len(self._paths)

    # --- what smbus2 calls ----------------------------------------------------------------------

    def open(self, path: str, _flags: int) -> int:
        if self.open_error is not None:
            raise self.open_error
        if path not in self.adapters:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), path)
        descriptor = os.open(os.devnull, os.O_RDWR)
        self._paths[descriptor] = path
        return descriptor

    def close(self, descriptor: int) -> None:
        del self._paths[descriptor]
        os.close(descriptor)

    def ioctl(self, descriptor: int, request: int, argument: Any) -> int:
        path = self._paths[descriptor]
        if path not in self.adapters:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        if request == I2C_FUNCS:
            argument.value = self.functions
        elif request == I2C_TIMEOUT:
            self.timeout_10ms = argument
        elif request == I2C_RDWR:
            self._transfer(path, [argument.msgs[i] for i in range(argument.nmsgs)])
        else:
            raise OSError(errno.ENOTTY, os.strerror(errno.ENOTTY))
        return 0

    def _transfer(self, path: str, messages: Sequence[Any]) -> None:
        self.time.advance(_TRANSFER_S)
        if self.stuck:
            self.time.advance(self.timeout_10ms * 0.010)
            self._fail(errno.ETIMEDOUT)
        fails_at = -1
        if self._random.random() < self.fail_ratio:
            fails_at = self._random.randrange(len(messages))
        for index, message in enumerate(messages):
            chip = self.adapters[path].get(message.addr)
            if chip is None or index == fails_at or not chip.acknowledges():
                self.time.advance(_BYTE_S)
                self._fail(errno.EREMOTEIO)
            assert chip is not None
            self.time.advance(_BYTE_S * (message.len + 1))
            self._one_message(chip, message)

    def _one_message(self, chip: FakeChip, message: Any) -> None:
        if message.flags & I2C_M_RD:
            data = chip.read(message.len)
            assert len(data) == message.len
            ctypes.memmove(message.buf, data, message.len)
        else:
            data = ctypes.string_at(message.buf, message.len)
            self.writes.append((message.addr, data))
            chip.write(data)

    def _fail(self, number: int) -> None:
        self.failures_ns.append(self.time.now_ns)
        raise OSError(number, os.strerror(number))
