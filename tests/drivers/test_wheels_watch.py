"""What the wheel driver says of error frames and silence, over python-can's in-process bus."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence

import can
import pytest

from drivers.errors import DriverError
from drivers.samples import CanFrameSample, WheelTwistSample
from drivers.wheels.can_wheels import Wheels
from tests.fakes.fake_time import FakeTime

PUMA_SPEED = 0x02021540
TwistOrFrame = CanFrameSample | WheelTwistSample


def frames_of(samples: Sequence[TwistOrFrame]) -> list[CanFrameSample]:
    return [s for s in samples if isinstance(s, CanFrameSample)]


class VirtualVehicle:
    """The other end of python-can's in-process bus."""

    def __init__(self) -> None:
        self.time = FakeTime()
        self.bus = can.Bus(interface="virtual", channel="vehicle", ignore_config=True)
        self.wheels = Wheels("vehicle", interface="virtual", clock=self.time, sleep=self.time.sleep)

    def send_speed(self, device: int, shaft_rpm: float) -> None:
        data = struct.pack("<i", round(shaft_rpm * 65536))
        self.bus.send(can.Message(arbitration_id=PUMA_SPEED | device, data=data))


@pytest.fixture
def vehicle() -> Iterator[VirtualVehicle]:
    fake = VirtualVehicle()
    fake.wheels.open()
    yield fake
    fake.wheels.close()
    fake.bus.shutdown()


def test_error_frames_are_kept_and_counted(vehicle: VirtualVehicle) -> None:
    vehicle.bus.send(can.Message(arbitration_id=0x04, data=bytes(8), is_error_frame=True))
    (frame,) = frames_of(vehicle.wheels.read(0.0))
    assert frame.is_error
    assert vehicle.wheels.bus_counters.error_frames == 1


def test_bus_off_is_an_error_after_the_frames_before_it(vehicle: VirtualVehicle) -> None:
    vehicle.send_speed(2, 1.0)
    vehicle.bus.send(can.Message(arbitration_id=0x40, data=bytes(8), is_error_frame=True))
    assert [f.is_error for f in frames_of(vehicle.wheels.read(0.0))] == [False, True]
    with pytest.raises(DriverError, match="wheels: virtual:vehicle: bus-off"):
        vehicle.wheels.read(0.0)
    vehicle.send_speed(2, 1.0)
    assert len(vehicle.wheels.read(0.0)) == 1


def test_silence_is_an_error_and_frames_end_it(vehicle: VirtualVehicle) -> None:
    assert vehicle.wheels.read(0.0) == []
    vehicle.time.advance(1.1)
    with pytest.raises(DriverError, match=r"for 1 s no CAN frame; is the vehicle on"):
        vehicle.wheels.read(0.0)
    assert vehicle.wheels.read(0.0) == []
    vehicle.send_speed(2, 1.0)
    assert len(vehicle.wheels.read(0.0)) == 1


def test_a_silent_wheel_is_named(vehicle: VirtualVehicle) -> None:
    def drive_on_three_wheels() -> None:
        for _ in range(12):
            vehicle.time.advance(0.1)
            for device in (2, 3, 5):
                vehicle.send_speed(device, 1.0)
            assert not [s for s in vehicle.wheels.read(0.0) if isinstance(s, WheelTwistSample)]

    with pytest.raises(
        DriverError, match=r"CAN frames but no twist; nothing from PumaSpeed4\.Speed"
    ):
        drive_on_three_wheels()


def test_remote_frames_are_kept(vehicle: VirtualVehicle) -> None:
    vehicle.bus.send(can.Message(arbitration_id=0x221, is_remote_frame=True, is_extended_id=False))
    (frame,) = frames_of(vehicle.wheels.read(0.0))
    assert (frame.is_remote, frame.is_extended, frame.data) == (True, False, b"")


def test_reading_a_closed_bus_is_an_error() -> None:
    with pytest.raises(DriverError, match="wheels: not open"):
        Wheels("x", interface="virtual").read(0.0)
