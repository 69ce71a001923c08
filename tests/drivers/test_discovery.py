"""What is found in made-up trees of /sys and /dev, and what is said about it."""

from __future__ import annotations

import grp
import importlib.util
import os
import re
from dataclasses import dataclass
from pathlib import Path

import pytest

from drivers.discovery import Finding, find_devices, udev_rules_path
from tests.fakes.ordinary_user import ordinary_user


@dataclass
class Port:
    """Looks like pyserial's description of a port."""

    device: str
    name: str
    description: str
    vid: int | None


class Machine:
    """A machine's /sys and /dev in a folder, and its serial ports."""

    def __init__(self, folder: Path) -> None:
        self.sys, self.dev, self.libraries = folder / "sys", folder / "dev", folder / "lib"
        self.ports: list[Port] = []
        for path in (self.sys, self.dev, self.libraries):
            path.mkdir()

    def attribute(self, path: str, value: str) -> None:
        file = self.sys / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(value + "\n")

    def node(self, path: str, mode: int = 0o600) -> Path:
        file = self.dev / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
        file.chmod(mode)
        return file

    def serial(self, name: str, description: str, vid: int | None) -> None:
        self.ports.append(Port(f"/dev/{name}", name, description, vid))

    def usb(self, place: str, product: str, number: int) -> None:
        for name, value in {
            "idVendor": "045e", "idProduct": product, "busnum": "1", "devnum": str(number),
        }.items():  # fmt: skip
            self.attribute(f"bus/usb/devices/{place}/{name}", value)
        self.node(f"bus/usb/001/{number:03d}")

    def find(self) -> list[Finding]:
        return find_devices(
            sys_root=self.sys,
            dev_root=self.dev,
            serial_ports=self.ports,
            library_folders=[self.libraries],
        )

    def find_one(self) -> Finding:
        (finding,) = self.find()
        return finding


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_nothing_is_plugged_in(machine: Machine) -> None:
    assert machine.find() == []


def test_this_machine_can_be_asked() -> None:
    for finding in find_devices():
        assert finding.usable or (finding.problem and finding.advice)


def test_missing_pyserial_is_said(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _name: None)
    (finding,) = find_devices(sys_root=machine.sys, dev_root=machine.dev)
    assert (finding.usable, finding.problem) == (False, "pyserial is missing")
    assert finding.advice == "pip install 'terravibe[vibration]'"


def test_serial_port(machine: Machine) -> None:
    machine.node("ttyACM0")
    machine.serial("ttyACM0", "WTVB01-485", 0x1A86)
    assert machine.find_one() == Finding("serial", "/dev/ttyACM0", "WTVB01-485", usable=True)


@pytest.mark.parametrize(("latency_ms", "is_slow"), [("16", True), ("1", False)])
def test_ftdi_latency(machine: Machine, latency_ms: str, is_slow: bool) -> None:
    machine.node("ttyUSB0")
    machine.serial("ttyUSB0", "FT232R USB UART", 0x0403)
    machine.attribute("bus/usb-serial/devices/ttyUSB0/latency_timer", latency_ms)
    finding = machine.find_one()
    assert finding.usable
    if is_slow:
        assert finding.problem == "the adapter holds data back for 16 ms, expected 1"
        assert f"sudo cp {udev_rules_path()} /etc/udev/rules.d/" in finding.advice
    else:
        assert not finding.problem


def test_serial_nodes_without_hardware_are_left_out(machine: Machine) -> None:
    for name, uart in (("ttyS0", "4"), ("ttyS1", "0")):  # 4: a 16550A, 0: unknown
        machine.node(name)
        machine.serial(name, "n/a", None)
        machine.attribute(f"class/tty/{name}/type", uart)
    assert machine.find_one() == Finding("serial", "/dev/ttyS0", "", usable=True)


def test_a_port_that_vanished(machine: Machine) -> None:
    machine.serial("ttyUSB0", "CH340", 0x1A86)
    finding = machine.find_one()
    assert not finding.usable
    assert finding.problem.endswith("ttyUSB0: No such file or directory")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give files to other groups")
def test_the_missing_group_is_named() -> None:
    dialout = grp.getgrnam("dialout").gr_gid
    with ordinary_user() as folder:
        machine = Machine(folder)
        machine.serial("ttyUSB0", "CH340", 0x1A86)
        node = machine.node("ttyUSB0", 0o060)
        os.seteuid(0)
        os.chown(node, 0, dialout)
        os.seteuid(65534)
        finding = machine.find_one()
        assert not finding.usable
        assert finding.problem.endswith("ttyUSB0, which belongs to group dialout")
        assert finding.advice.startswith("run 'sudo usermod --append --groups dialout $USER'")


def test_a_node_for_root_alone_needs_the_rules() -> None:
    with ordinary_user() as folder:
        machine = Machine(folder)
        machine.attribute("bus/i2c/devices/i2c-1/name", "bcm2835 (i2c@7e804000)")
        machine.node("i2c-1", 0)
        finding = machine.find_one()
        assert (finding.kind, finding.what, finding.usable) == (
            "i2c",
            "bcm2835 (i2c@7e804000)",
            False,
        )
        assert "which no group may use" in finding.problem
        assert "60-terravibe.rules /etc/udev/rules.d/" in finding.advice


def test_i2c_buses_in_the_order_of_their_numbers(machine: Machine) -> None:
    for number in (10, 2):
        machine.attribute(f"bus/i2c/devices/i2c-{number}/name", "adapter")
        machine.node(f"i2c-{number}")
    machine.attribute("bus/i2c/devices/2-0068/name", "mpu6050")  # a chip, not a bus
    assert [Path(finding.where).name for finding in machine.find()] == ["i2c-2", "i2c-10"]
    assert all(finding.usable for finding in machine.find())


def test_i2c_without_its_module(machine: Machine) -> None:
    machine.attribute("bus/i2c/devices/i2c-1/name", "adapter")
    finding = machine.find_one()
    assert (finding.usable, finding.problem) == (False, "the bus has no device node")
    assert "modprobe i2c-dev" in finding.advice


@pytest.mark.parametrize(
    ("flags", "is_real", "expected"),
    [
        ("0x41", True, Finding("can", "can0", "gs_usb", usable=True)),
        (
            "0x40080",
            True,
            Finding(
                "can", "can0", "gs_usb", False, "the link is down",
                "run 'sudo ip link set can0 up type can bitrate 500000' with the bit rate of the "
                "vehicle",
            ),
        ),
        (
            "0x40080",
            False,
            Finding(
                "can", "can0", "virtual", False, "the link is down",
                "run 'sudo ip link set can0 up'",
            ),
        ),
    ],
)  # fmt: skip
def test_can_interface(machine: Machine, flags: str, is_real: bool, expected: Finding) -> None:
    machine.attribute("class/net/eth0/type", "1")
    machine.attribute("class/net/can0/type", "280")
    machine.attribute("class/net/can0/flags", flags)
    if is_real:
        driver = machine.sys / "bus/usb/drivers/gs_usb"
        driver.mkdir(parents=True)
        device = machine.sys / "class/net/can0/device"
        device.mkdir()
        (device / "driver").symlink_to(driver)
    assert machine.find_one() == expected


def install_openni(machine: Machine, *, with_freenect: bool) -> None:
    (machine.libraries / "libOpenNI2.so").touch()
    if with_freenect:
        drivers = machine.libraries / "OpenNI2" / "Drivers"
        drivers.mkdir(parents=True)
        (drivers / "libFreenectDriver.so.0").touch()


def test_kinect_that_is_ready(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _name: object())
    machine.usb("1-2.1", "02ae", 7)
    machine.usb("1-2.2", "02ad", 8)
    machine.usb("1-2.3", "02b0", 9)
    install_openni(machine, with_freenect=True)
    assert machine.find_one() == Finding("kinect", "usb 1-2.1", "Kinect V1 camera", usable=True)


def test_kinect_without_libraries(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _name: None)
    machine.usb("1-2.1", "02ae", 7)
    assert "apt install libopenni2-0 libopenni2-dev" in machine.find_one().advice
    install_openni(machine, with_freenect=False)
    finding = machine.find_one()
    assert finding.problem.endswith("Drivers has no libFreenectDriver.so")
    assert "BUILD_OPENNI2_DRIVER" in finding.advice
    (machine.libraries / "libOpenNI2.so").unlink()
    install_openni(machine, with_freenect=True)
    assert machine.find_one().advice == "pip install 'terravibe[kinect]'"
    assert not machine.find_one().usable


def test_kinect_without_permission() -> None:
    with ordinary_user() as folder:
        machine = Machine(folder)
        machine.usb("1-2.1", "02ae", 7)
        (machine.dev / "bus/usb/001/007").chmod(0)
        finding = machine.find_one()
        assert "bus/usb/001/007, which no group may use" in finding.problem
        assert not finding.usable


def test_kinect_without_its_supply(machine: Machine) -> None:
    machine.usb("1-2.3", "02b0", 9)
    assert machine.find_one() == Finding(
        "kinect", "usb 1-2.3", "Kinect V1 motor", False,
        "only the motor answers, not the camera", "connect the 12 V supply of the Kinect",
    )  # fmt: skip


def test_udev_rules_are_well_formed() -> None:
    pair = re.compile(r"[A-Z]+(\{\w+\})?(==|\+=|=)\"[^\"]+\"")
    lines = udev_rules_path().read_text(encoding="ascii").splitlines()
    rules = [line for line in lines if line and not line.startswith("#")]
    for rule in rules:
        for part in rule.split(", "):
            assert pair.fullmatch(part), part
    text = "\n".join(rules)
    for needed in ('ATTR{latency_timer}="1"', "02ae", "02ad", "02b0", "dialout", "i2c", "plugdev"):
        assert needed in text
