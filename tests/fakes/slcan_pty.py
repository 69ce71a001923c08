"""An slcan (LAWICEL) adapter on a pseudo-terminal, for unmodified python-can and pyserial.

Bytes leave in chunks that ignore line ends.

Not simulated: the CAN bus itself (arbitration, error states, bus-off), baud rates, an adapter
that resets when it is opened, time stamps, CAN FD, and flow control other than a full buffer.
"""

from __future__ import annotations

import random
from collections.abc import Iterable
from pathlib import Path

from tests.fakes.pty_endpoint import PtyEndpoint


def frame_line(arbitration_id: int, data: bytes, *, extended: bool) -> bytes:
    """Return the line that an adapter sends for a received data frame."""
    head = f"T{arbitration_id:08X}" if extended else f"t{arbitration_id:03X}"
    return f"{head}{len(data)}{data.hex().upper()}\r".encode()


class SlcanPty(PtyEndpoint):
    """An adapter; `feed` queues bytes and `pump` lets them out as far as they fit."""

    def __init__(self, path: Path, *, seed: int = 0) -> None:
        super().__init__(path)
        self.commands: list[str] = []
        self._random = random.Random(seed)
        self._pending = bytearray()
        self._command = bytearray()

    def unplug(self) -> None:
        """Take the adapter away, with all that waits in it."""
        super().unplug()
        self._pending.clear()
        self._command.clear()
        self.commands.clear()

    @property
    def is_streaming(self) -> bool:
        """Whether the host has opened the CAN channel; its command may take a moment to arrive."""
        while self.wait(0.0 if self._is_open() else 1.0):
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
            written = self.write(bytes(self._pending[: self._random.randrange(1, 97)]))
            if not written:
                break
            del self._pending[:written]
        return len(self._pending)

    def _read_commands(self) -> None:
        self._command += self.read()
        *lines, rest = bytes(self._command).split(b"\r")
        self._command = bytearray(rest)
        self.commands += [line.decode() for line in lines]
