"""An slcan (LAWICEL) adapter on a pseudo-terminal, for unmodified python-can and pyserial.

The device node is a symbolic link to the pseudo-terminal, as udev would make one, so that the
adapter keeps its name when it is plugged in again. Bytes leave in chunks that ignore line ends.

Not simulated: the CAN bus itself (arbitration, error states, bus-off), baud rates, an adapter
that resets when it is opened, time stamps, CAN FD, and flow control other than a full buffer.
"""

from __future__ import annotations

import os
import random
import select
import tty
from collections.abc import Iterable
from pathlib import Path


def frame_line(arbitration_id: int, data: bytes, *, extended: bool) -> bytes:
    """Return the line that an adapter sends for a received data frame."""
    head = f"T{arbitration_id:08X}" if extended else f"t{arbitration_id:03X}"
    return f"{head}{len(data)}{data.hex().upper()}\r".encode()


class SlcanPty:
    """One adapter at `path`; `feed` queues bytes and `pump` lets them out as far as they fit."""

    def __init__(self, path: Path, *, seed: int = 0) -> None:
        self.path = path
        self.commands: list[str] = []
        self._random = random.Random(seed)
        self._pending = bytearray()
        self._command = bytearray()
        self._master = self._slave = -1
        self.plug()

    def plug(self) -> None:
        """Appear at `path`."""
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path.symlink_to(os.ttyname(self._slave))

    def unplug(self) -> None:
        """Disappear; whoever has the port open gets EIO."""
        self.path.unlink()
        os.close(self._master)
        os.close(self._slave)
        self._pending.clear()
        self._command.clear()
        self.commands.clear()

    @property
    def is_streaming(self) -> bool:
        """Whether the host has opened the CAN channel; its command may take a moment to arrive."""
        while select.select([self._master], [], [], 0.0 if self._is_open() else 1.0)[0]:
            self._read_commands()
        return self._is_open()

    def _is_open(self) -> bool:
        switched = [command for command in self.commands if command in ("O", "L", "C")]
        return bool(switched) and switched[-1] != "C"

    def feed(self, lines: Iterable[bytes]) -> None:
        """Queue bytes behind those that wait."""
        for line in lines:
            self._pending += line

    def garbage(self, length: int) -> bytes:
        """Return that many random bytes, which end no line and look like no frame."""
        return bytes(self._random.choice(b"\x00\x11ghz\x7f\xb7\xff") for _ in range(length))

    def pump(self) -> int:
        """Write what fits into the terminal's buffer, in odd chunks; return how much waits."""
        assert self.is_streaming, "the host has not opened the channel"
        while self._pending:
            chunk = self._pending[: self._random.randrange(1, 97)]
            try:
                written = os.write(self._master, chunk)
            except BlockingIOError:
                break
            del self._pending[:written]
        return len(self._pending)

    def _read_commands(self) -> None:
        self._command += os.read(self._master, 4096)
        *lines, rest = bytes(self._command).split(b"\r")
        self._command = bytearray(rest)
        self.commands += [line.decode() for line in lines]
