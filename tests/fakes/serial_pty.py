"""Vibration sensors behind a pty, for the real pyserial to talk to.

Not simulated: baud rates (a device answers at any speed), the time that bytes take, the USB
adapter, and what the firmware of a real device does outside the messages below.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol, Self

from drivers.vibration.checksums import crc16_modbus
from tests.fakes.pty_endpoint import PtyEndpoint


class Behaviour(Protocol):
    """What is inside the device."""

    def step(self, received: bytes) -> bytes:
        """Take what the host sent, return what the device sends; called every millisecond."""


class FakeSerialDevice:
    """A device at `path`, plugged in and running in a thread while the context lasts.

    Attributes:
        chunks: the answer is delivered in pieces of these sizes, each after the host has read
            the one before; what is left over comes last. Empty: in one piece.
    """

    def __init__(self, path: Path, behaviour: Behaviour, chunks: Sequence[int] = ()) -> None:
        self.chunks = chunks
        self._endpoint = PtyEndpoint(path)
        self._behaviour = behaviour
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="fake serial device")
        self._unplug_after: int | None = None

    def __enter__(self) -> Self:
        self._endpoint.replug()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._endpoint.unplug()

    def unplug_after(self, sends: int) -> None:
        """Pull the cable when the device has sent that many more times."""
        with self._lock:
            self._unplug_after = sends

    def replug(self) -> None:
        """Put the cable back."""
        with self._lock:
            self._endpoint.replug()

    @contextmanager
    def quiet(self) -> Iterator[PtyEndpoint]:
        """Hold the device still, so that a test can send exactly what it wants."""
        with self._lock:
            yield self._endpoint

    def _run(self) -> None:
        while not self._stop.wait(0.001):
            with self._lock:
                if self._endpoint.plugged:
                    self._step()

    def _step(self) -> None:
        data = self._behaviour.step(self._endpoint.read())
        if not data:
            return
        for size in self.chunks:
            self._endpoint.write(data[:size])
            data = data[size:]
            self._wait_until_read()
        self._endpoint.write(data)
        if self._unplug_after is not None:
            self._unplug_after -= 1
            if self._unplug_after <= 0:
                self._unplug_after = None
                self._endpoint.unplug()

    def _wait_until_read(self) -> None:
        for _ in range(100):
            if not self._endpoint.unread():
                return
            time.sleep(0.0005)


class Streamer:
    """A device that sends one frame after the other: the BT50, and the AFT601D as assumed.

    Attributes:
        silent: whether it holds its tongue.
        garbage: what it sends before the next frame.
        received: what the host has sent it.
    """

    def __init__(self, frames: Sequence[bytes]) -> None:
        self._frames = itertools.cycle(frames)
        self.silent = False
        self.garbage = b""
        self.received = b""

    def step(self, received: bytes) -> bytes:
        self.received += received
        if self.silent:
            return b""
        garbage, self.garbage = self.garbage, b""
        return garbage + next(self._frames)


class Wtvb01Slave:
    """A WTVB01-485: functions 03 and 06, unlocking, and the high-speed mode that nothing ends.

    Attributes:
        registers: its registers, by address.
        requests: what it was asked, for a test to look at.
        faults: what to do instead of answering the next requests: "silence", "exception",
            "wrong-slave", "corrupt", "truncate" or "garbage-first".
    """

    def __init__(self, address: int = 0x50) -> None:
        self.address = address
        self.registers = {0x04: 2, 0x1A: address, 0x65: 100}
        self.requests: list[bytes] = []
        self.faults: deque[str] = deque()
        self.high_speed = False
        self._unlocked = False
        self._pending = b""

    def step(self, received: bytes) -> bytes:
        if self.high_speed:
            return self._with_crc(bytes([self.address, 3]) + self._data(0x47, 3))
        self._pending += received
        if len(self._pending) < 8:
            return b""
        request, self._pending = self._pending[:8], self._pending[8:]
        self.requests.append(request)
        if crc16_modbus(request) or request[0] != self.address:
            return b""
        return self._spoil(self._answer(request))

    def _answer(self, request: bytes) -> bytes:
        function = request[1]
        register, value = int.from_bytes(request[2:4], "big"), int.from_bytes(request[4:6], "big")
        if function == 3:
            return self._with_crc(bytes([self.address, 3]) + self._data(register, value))
        if function == 6 and (register, value) == (0x69, 0xB588):
            self._unlocked = True
        elif function == 6 and self._unlocked:
            self.registers[register] = value
            self.high_speed = (register, value) == (0x62, 1)
            if self.high_speed:
                return b""
        else:
            return self._with_crc(bytes([self.address, function | 0x80, 1]))
        return request

    def _data(self, first: int, count: int) -> bytes:
        values = [self.registers.get(first + i, 0) & 0xFFFF for i in range(count)]
        return bytes([2 * count]) + b"".join(value.to_bytes(2, "big") for value in values)

    def _spoil(self, reply: bytes) -> bytes:
        fault = self.faults.popleft() if self.faults else None
        match fault:
            case "silence":
                return b""
            case "exception":
                return self._with_crc(bytes([self.address, reply[1] | 0x80, 2]))
            case "wrong-slave":
                return self._with_crc(bytes([self.address + 1]) + reply[1:-2])
            case "corrupt":
                return reply[:-1] + bytes([reply[-1] ^ 1])
            case "truncate":
                return reply[:-9]
            case "garbage-first":
                return b"\x00\x50\x03\xff" + reply
        return reply

    @staticmethod
    def _with_crc(data: bytes) -> bytes:
        return data + crc16_modbus(data).to_bytes(2, "little")
