"""The device's end of a serial cable: a pseudo-terminal under a stable path.

Not simulated: speed (bytes arrive at once), parity, modem lines, the latency of a USB adapter and
its way of grouping bytes. A terminal keeps up to 4 kB that nobody reads; more is dropped, as a
UART's buffer would.
"""

from __future__ import annotations

import array
import fcntl
import os
import select
import termios
import tty
from pathlib import Path
from typing import Self


class PtyEndpoint:
    """A pty whose slave is found at `path`; `unplug` and `replug` as often as you like.

    Unplugging takes the path away and makes the port that a program has open fail as a pulled
    USB adapter does; replugging puts a new device at the same path. Not thread-safe.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._device = -1
        self._host = -1

    def __enter__(self) -> Self:
        self.replug()
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()

    @property
    def plugged(self) -> bool:
        """Whether there is a device at the path."""
        return self._device >= 0

    def replug(self) -> None:
        """Make a new terminal and put it at the path."""
        self._device, self._host = os.openpty()
        tty.setraw(self._host)
        os.set_blocking(self._device, False)
        self.path.symlink_to(os.ttyname(self._host))

    def unplug(self) -> None:
        """Take the device away; harmless when it is away."""
        if self.plugged:
            self.path.unlink()
            os.close(self._host)
            os.close(self._device)
            self._device = self._host = -1

    def write(self, data: bytes) -> int:
        """Send to the host; return how many bytes there was room for."""
        try:
            return os.write(self._device, data)
        except BlockingIOError:
            return 0

    def wait(self, timeout_s: float) -> bool:
        """Wait until the host has sent something that is not read yet; return whether it has."""
        return bool(select.select([self._device], [], [], timeout_s)[0])

    def read(self) -> bytes:
        """Return what the host has sent since the last call."""
        try:
            return os.read(self._device, 65536)
        except BlockingIOError:
            return b""

    def unread(self) -> int:
        """Return how many of the bytes written here the host has not read."""
        count = array.array("i", [0])
        fcntl.ioctl(self._host, termios.FIONREAD, count)
        return count[0]
