"""Talking to systemd: ready, alive, stopping. Without systemd it does nothing.

The protocol is sd_notify(3): one datagram of KEY=VALUE lines to the socket in NOTIFY_SOCKET.
The watchdog interval is in WATCHDOG_USEC, for the process in WATCHDOG_PID (sd_watchdog_enabled).
"""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping
from importlib.resources import files

from acquisition.health.snapshot import HealthSnapshot
from acquisition.health.views import title_of


class ServiceNotifier:
    """Sends states to the service manager; never blocks and never fails.

    Pass `heartbeat` to `Recorder.run`: the recording thread itself then feeds the watchdog, so
    that a recorder that hangs in its disk is restarted.
    """

    def __init__(self, address: str, *, watchdog: bool) -> None:
        """Use `from_environment` unless the address is known; "" = nobody listens."""
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._watchdog = watchdog
        self._ready = False

    @classmethod
    def from_environment(cls, environment: Mapping[str, str] = os.environ) -> ServiceNotifier:
        """Return a notifier for the manager that started this process, if one did."""
        for_us = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        return cls(
            environment.get("NOTIFY_SOCKET", ""),
            watchdog=for_us and "WATCHDOG_USEC" in environment,
        )

    def heartbeat(self, snapshot: HealthSnapshot) -> None:
        """Say that recording goes on: READY=1 the first time, the watchdog, and a status line."""
        lines = [f"STATUS={title_of(snapshot)}"]
        if not self._ready:
            lines.append("READY=1")
            self._ready = True
        if self._watchdog:
            lines.append("WATCHDOG=1")
        self._send("\n".join(lines))

    def stopping(self, reason: str) -> None:
        """Say that the recorder is coming to its end."""
        self._send(f"STOPPING=1\nSTATUS={reason}")

    def _send(self, text: str) -> None:
        if not self._address:
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as sender:
            try:
                sender.sendto(text.encode(), self._address)
            except OSError:
                return  # the manager is gone or its queue is full; recording is what matters


def unit_text() -> str:
    """Return the systemd unit file that docs/install_vehicle.md installs."""
    return (
        files("acquisition.recording")
        .joinpath("terravibe-record.service")
        .read_text(encoding="utf-8")
    )
