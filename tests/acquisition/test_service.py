"""sd_notify: what a service manager hears, and that its absence does no harm."""

from __future__ import annotations

import configparser
import os
import socket
from pathlib import Path

import pytest

from acquisition.health.snapshot import HealthSnapshot
from acquisition.recording.service import ServiceNotifier, unit_text

SNAPSHOT = HealthSnapshot(0, 12.0, 3_000_000, 10**9, 0.0, (), ())


def heard(manager: socket.socket) -> list[str]:
    return manager.recv(4096).decode().splitlines()


@pytest.mark.parametrize("abstract", [False, True])
def test_the_manager_hears_ready_once_then_the_watchdog(tmp_path: Path, abstract: bool) -> None:
    name = f"@terravibe-test-{os.getpid()}" if abstract else str(tmp_path / "notify")
    environment = {"NOTIFY_SOCKET": name, "WATCHDOG_USEC": "10000000"}
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind("\0" + name[1:] if abstract else name)
        manager.settimeout(5.0)
        notifier = ServiceNotifier.from_environment(environment)
        status = "STATUS=0:00:12 recorded, 3.0 MB written, 1.0 GB free"
        notifier.heartbeat(SNAPSHOT)
        assert heard(manager) == [status, "READY=1", "WATCHDOG=1"]
        notifier.heartbeat(SNAPSHOT)
        assert heard(manager) == [status, "WATCHDOG=1"]
        notifier.stopping("disk full")
        assert heard(manager) == ["STOPPING=1", "STATUS=disk full"]


def test_a_watchdog_of_another_process_is_not_fed(tmp_path: Path) -> None:
    name = str(tmp_path / "notify")
    environment = {"NOTIFY_SOCKET": name, "WATCHDOG_USEC": "1", "WATCHDOG_PID": "1"}
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(name)
        manager.settimeout(5.0)
        ServiceNotifier.from_environment(environment).heartbeat(SNAPSHOT)
        assert "WATCHDOG=1" not in heard(manager)


@pytest.mark.parametrize("environment", [{}, {"NOTIFY_SOCKET": "/nowhere/notify"}])
def test_nobody_listening_does_no_harm(environment: dict[str, str]) -> None:
    ServiceNotifier.from_environment(environment).heartbeat(SNAPSHOT)


def test_a_manager_that_does_not_read_does_not_hold_up_recording(tmp_path: Path) -> None:
    name = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(name)
        notifier = ServiceNotifier(name, watchdog=True)
        for _ in range(1000):  # far more than a socket's queue takes
            notifier.heartbeat(SNAPSHOT)
        manager.settimeout(5.0)
        assert "READY=1" in heard(manager)


def test_the_unit_file_is_one_and_watches() -> None:
    unit = configparser.ConfigParser(strict=False)
    unit.optionxform = str  # type: ignore[assignment,method-assign] # how configparser is told
    unit.read_string(unit_text())
    assert unit["Service"]["Type"] == "notify"
    assert int(unit["Service"]["WatchdogSec"]) >= 5
    assert unit["Service"]["Restart"] == "on-failure"
