"""What is plugged in, and whether this user can use it; opens no device."""

from __future__ import annotations

import grp
import importlib.util
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from drivers.depth.openni_library import (
    FREENECT_ADVICE,
    driver_folder,
    find_library,
    has_freenect_driver,
    usual_folders,
)
from drivers.errors import DriverError

Kind = Literal["serial", "i2c", "can", "kinect"]

_FTDI_VENDOR = 0x0403
_MAX_LATENCY_MS = 1
_ARPHRD_CAN = "280"  # linux/if_arp.h
_IFF_UP = 0x1  # linux/if.h
_MICROSOFT = "045e"
_KINECT_PRODUCTS = {"02ae": "camera", "02ad": "audio", "02b0": "motor"}


@dataclass(frozen=True, slots=True)
class Finding:
    """One device, or one part of it.

    Attributes:
        kind: which sort of device.
        where: its node, network interface or USB address.
        what: what it says about itself, "" where it says nothing.
        usable: whether it can be opened as things are.
        problem: what is wrong, or works less well than it could; "" if nothing is.
        advice: what to do about the problem.
    """

    kind: Kind
    where: str
    what: str
    usable: bool
    problem: str = ""
    advice: str = ""


class SerialPort(Protocol):
    """What is used of pyserial's description of a port."""

    device: str
    name: str
    description: str
    vid: int | None


def udev_rules_path() -> Path:
    """Return the udev rules that give ordinary users access; to copy to /etc/udev/rules.d."""
    return Path(__file__).parent / "udev" / "60-terravibe.rules"


def find_devices(
    *,
    sys_root: Path = Path("/sys"),
    dev_root: Path = Path("/dev"),
    serial_ports: Iterable[SerialPort] | None = None,
    library_folders: Sequence[Path] | None = None,
) -> list[Finding]:
    """Return everything that is plugged in, usable or not.

    Args:
        sys_root: where sysfs is.
        dev_root: where the device nodes are.
        serial_ports: the serial ports; None to ask pyserial.
        library_folders: where libOpenNI2 may be; None for the usual places.
    """
    folders = usual_folders() if library_folders is None else library_folders
    return [
        *_serial(sys_root, dev_root, serial_ports),
        *_i2c(sys_root, dev_root),
        *_can(sys_root),
        *_kinect(sys_root, dev_root, folders),
    ]


def _serial(
    sys_root: Path, dev_root: Path, ports: Iterable[SerialPort] | None
) -> Iterator[Finding]:
    if ports is None:
        if importlib.util.find_spec("serial") is None:
            advice = "pip install 'terravibe[vibration]'"
            yield Finding("serial", str(dev_root), "", False, "pyserial is missing", advice)
            return
        from serial.tools.list_ports import comports

        ports = sorted(comports())
    for port in ports:
        if port.vid is None and _read(sys_root / "class/tty" / port.name / "type") == "0":
            continue  # ttyS nodes without hardware behind them
        problem, advice = _access(dev_root / port.name)
        usable = not problem
        latency = _read(sys_root / "bus/usb-serial/devices" / port.name / "latency_timer")
        is_slow = latency.isdigit() and int(latency) > _MAX_LATENCY_MS
        if usable and port.vid == _FTDI_VENDOR and is_slow:
            problem = f"the adapter holds data back for {latency} ms, expected {_MAX_LATENCY_MS}"
            advice = _rules_advice()
        what = "" if port.description == "n/a" else port.description
        yield Finding("serial", port.device, what, usable, problem, advice)


def _i2c(sys_root: Path, dev_root: Path) -> Iterator[Finding]:
    for adapter in _numbered(sys_root / "bus/i2c/devices", "i2c-"):
        node = dev_root / adapter.name
        what = _read(adapter / "name")
        if node.exists():
            problem, advice = _access(node)
        else:
            problem = "the bus has no device node"
            advice = "run 'sudo modprobe i2c-dev', and name i2c-dev in /etc/modules to keep it"
        yield Finding("i2c", str(node), what, not problem, problem, advice)


def _can(sys_root: Path) -> Iterator[Finding]:
    for interface in sorted((sys_root / "class/net").glob("*")):
        if _read(interface / "type") != _ARPHRD_CAN:
            continue
        driver = interface / "device/driver"
        what = driver.resolve().name if driver.exists() else "virtual"
        name = interface.name
        if int(_read(interface / "flags") or "0", 16) & _IFF_UP:
            yield Finding("can", name, what, usable=True)
            continue
        bitrate = "" if what == "virtual" else " type can bitrate 500000"
        advice = f"run 'sudo ip link set {name} up{bitrate}'"
        if bitrate:
            advice += " with the bit rate of the vehicle"
        yield Finding("can", name, what, usable=False, problem="the link is down", advice=advice)


def _kinect(sys_root: Path, dev_root: Path, library_folders: Sequence[Path]) -> Iterator[Finding]:
    parts = {
        device: _KINECT_PRODUCTS[product]
        for device in sorted((sys_root / "bus/usb/devices").glob("*"))
        if _read(device / "idVendor") == _MICROSOFT
        and (product := _read(device / "idProduct")) in _KINECT_PRODUCTS
    }
    for device, part in parts.items():
        if part == "camera":
            problem, advice = _access(_usb_node(device, dev_root))
            if not problem:
                problem, advice = _openni_problem(library_folders)
            where = f"usb {device.name}"
            yield Finding("kinect", where, "Kinect V1 camera", not problem, problem, advice)
    if parts and "camera" not in parts.values():
        device, part = next(iter(parts.items()))
        yield Finding(
            "kinect",
            f"usb {device.name}",
            f"Kinect V1 {part}",
            usable=False,
            problem=f"only the {part} answers, not the camera",
            advice="connect the 12 V supply of the Kinect",
        )


def _usb_node(device: Path, dev_root: Path) -> Path:
    """Return the node of a USB device: bus and device number, three digits each."""
    bus, number = _read(device / "busnum"), _read(device / "devnum")
    return dev_root / "bus/usb" / bus.zfill(3) / number.zfill(3)


def _openni_problem(library_folders: Sequence[Path]) -> tuple[str, str]:
    """Return what is missing to read a Kinect V1, and what to do, or two empty texts."""
    try:
        folder = find_library(library_folders)
    except DriverError as error:
        problem, _, advice = str(error).partition("; ")
        return problem, advice
    if not has_freenect_driver(folder):
        return f"{driver_folder(folder)} has no libFreenectDriver.so", FREENECT_ADVICE
    if importlib.util.find_spec("openni") is None:
        return "the package openni is missing", "pip install 'terravibe[kinect]'"
    return "", ""


def _access(node: Path) -> tuple[str, str]:
    """Return why this user cannot read and write a node and what to do, or two empty texts."""
    try:
        status = node.stat()
    except OSError as error:
        return f"{node}: {error.strerror}", "plug the device in again"
    if os.access(node, os.R_OK | os.W_OK, effective_ids=True):
        return "", ""
    group = _group_name(status.st_gid)
    if status.st_mode & 0o060 == 0o060 and status.st_gid != 0:
        return (
            f"no permission for {node}, which belongs to group {group}",
            f"run 'sudo usermod --append --groups {group} $USER' and log in again",
        )
    return f"no permission for {node}, which no group may use", _rules_advice()


def _group_name(group_id: int) -> str:
    try:
        return grp.getgrgid(group_id).gr_name
    except KeyError:
        return str(group_id)


def _rules_advice() -> str:
    return (
        f"run 'sudo cp {udev_rules_path()} /etc/udev/rules.d/ && sudo udevadm control --reload "
        "&& sudo udevadm trigger' and plug it in again"
    )


def _numbered(folder: Path, prefix: str) -> list[Path]:
    """Return the entries of a folder that are the prefix and a number, in the number's order."""
    found = [path for path in folder.glob(f"{prefix}*") if path.name[len(prefix) :].isdigit()]
    return sorted(found, key=lambda path: int(path.name[len(prefix) :]))


def _read(path: Path) -> str:
    """Return the one line of a sysfs attribute, "" where it is missing."""
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
