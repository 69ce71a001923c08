"""One drive from standstill: the true motion, and what every device reports of it."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.samples import Sample
from simulation.devices.accelerometer import (
    Accelerometer,
    acceleration_stream,
    accelerometer_signal,
)
from simulation.devices.device_stream import DeviceStream
from simulation.devices.motion_capture import MotionCapture, pose_stream
from simulation.devices.vibration_windows import VibrationOutput, vibration_stream
from simulation.devices.wheel_frames import WheelBus, wheel_streams
from simulation.devices.yaw_gyro import Gyro, gyro_stream
from simulation.errors import SimulationError
from simulation.faults import Fault
from simulation.motion import START_NS, Motion
from simulation.terrain.height_grid import HeightGrid
from simulation.vehicle import jackal
from simulation.vehicle.drive_commands import (
    ORIGIN,
    STANDSTILL,
    DriveCommands,
    PlanarPose,
    Ramp,
    Twist,
)
from simulation.vehicle.fault_forces import FaultForces
from simulation.vehicle.soil import Soil
from simulation.vehicle.vehicle import Contact, Vehicle

Float64Array = NDArray[np.float64]

LONGEST_S = 3600.0
_COMMAND_MS = 20  # the base takes commands at 50 Hz


@dataclass(frozen=True, slots=True)
class DriveOptions:
    """Everything about a drive but ground, commands, length and seed.

    Attributes:
        start: where the vehicle stands first.
        rest_s: how long it stands there before the commands begin.
        contact: "soil", or "native" for hard ground.
        soil: constants of the soil.
        gravity_m_s2: downwards; the Moon's is 1.62.
        acceleration_m_s2, yaw_acceleration_rad_s2: ramps of the base's controller.
        accelerometer, vibration: the vibration sensor's inside, and what it makes of it.
        gyro, wheels, mocap: the other devices.
        faults: what goes wrong.
        start_ns: time of the start.
    """

    start: PlanarPose = ORIGIN
    rest_s: float = 3.0
    contact: Contact = "soil"
    soil: Soil = field(default_factory=Soil)
    gravity_m_s2: float = 9.80665
    acceleration_m_s2: float = 0.5
    yaw_acceleration_rad_s2: float = 1.5
    accelerometer: Accelerometer = field(default_factory=Accelerometer)
    vibration: VibrationOutput = field(default_factory=VibrationOutput)
    gyro: Gyro = field(default_factory=Gyro)
    wheels: WheelBus = field(default_factory=WheelBus)
    mocap: MotionCapture = field(default_factory=MotionCapture)
    faults: tuple[Fault, ...] = ()
    start_ns: int = START_NS

    def __post_init__(self) -> None:
        if self.contact not in ("soil", "native"):
            raise SimulationError(f"a contact {self.contact!r}; expected soil or native")
        if not (0.5 <= self.rest_s <= 60.0 and 0.1 <= self.gravity_m_s2 <= 30.0):
            raise SimulationError(
                f"rest_s {self.rest_s}, gravity_m_s2 {self.gravity_m_s2}; expected 0.5 to 60 s "
                "and 0.1 to 30 m/s^2"
            )


@dataclass(frozen=True, slots=True)
class VehicleRun:
    """A drive that is over.

    Attributes:
        motion: the truth.
        streams: what the devices reported; a device with two types of samples has two.
    """

    motion: Motion
    streams: tuple[DeviceStream, ...]

    def samples(self) -> Iterator[Sample]:
        """Yield the samples of all devices in the order of their stamps."""
        return heapq.merge(*self.streams, key=lambda sample: sample.t_ns)


def simulate_vehicle(
    grid: HeightGrid,
    commands: DriveCommands,
    seconds: float,
    seed: int,
    options: DriveOptions | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> VehicleRun:
    """Drive over the ground; the same arguments give the same bytes.

    Args:
        grid: the ground.
        commands: they begin after the rest.
        seconds: length of the run, the rest included.
        seed: of everything that is random; the physics is not.
        options: vehicle, devices and faults.
        on_progress: told the simulated seconds now and then.

    Raises:
        SimulationError: impossible seed or length, or the drive left the ground or fell over.
    """
    options = options or DriveOptions()
    if not options.rest_s < seconds <= LONGEST_S:
        raise SimulationError(
            f"a run of {seconds} s; expected more than the {options.rest_s:g} s of rest that it "
            f"begins with and at most {LONGEST_S:g} s"
        )
    if seed < 0:
        raise SimulationError(f"seed {seed}; expected 0 or more")
    motion = _drive(grid, commands, round(seconds * 1000), options, on_progress)
    return VehicleRun(motion, _streams(motion, seed, options))


def _drive(
    grid: HeightGrid,
    commands: DriveCommands,
    steps: int,
    options: DriveOptions,
    on_progress: Callable[[float], None] | None,
) -> Motion:
    """Return the motion of one drive."""
    vehicle = Vehicle(
        grid,
        options.contact,
        options.soil,
        options.gravity_m_s2,
        options.accelerometer.position_m,
    )
    vehicle.place(*options.start)
    forces = FaultForces(options.faults, vehicle)
    ramp = Ramp(options.acceleration_m_s2, options.yaw_acceleration_rad_s2)
    rest_steps = math.ceil(options.rest_s * 1000 / _COMMAND_MS) * _COMMAND_MS
    rows = [np.empty((steps + 1, width)) for width in (3, 4, 3, 3, 3, 4, 2)]
    twist = STANDSTILL
    _record(rows, 0, vehicle, twist)
    for k in range(steps):
        if k % _COMMAND_MS == 0:
            elapsed_s = (k - rest_steps) * 1e-3
            wanted = commands.twist(elapsed_s, _planar(vehicle)) if elapsed_s >= 0 else STANDSTILL
            twist = ramp.step(wanted, _COMMAND_MS * 1e-3)
            if on_progress is not None:
                on_progress(k * 1e-3)
        vehicle.advance(*forces.at(k * 1e-3, _wheel_rates(twist)))
        _record(rows, k + 1, vehicle, twist)
    for row in rows:
        row.flags.writeable = False
    return Motion(options.start_ns, *rows)


def _record(rows: list[Float64Array], k: int, vehicle: Vehicle, twist: Twist) -> None:
    """Write the vehicle's state into row k, in the order of Motion's attributes."""
    state: tuple[ArrayLike, ...] = (
        vehicle.position_m,
        vehicle.quat_wxyz,
        vehicle.velocity_m_s,
        vehicle.body_rate_rad_s,
        vehicle.acceleration_m_s2,
        vehicle.wheel_rate_rad_s,
        twist,
    )
    for row, value in zip(rows, state, strict=True):
        row[k] = value


def _planar(vehicle: Vehicle) -> PlanarPose:
    w, x, y, z = vehicle.quat_wxyz.tolist()
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    x_m, y_m, _ = vehicle.position_m.tolist()
    return PlanarPose(x_m, y_m, yaw)


def _wheel_rates(twist: Twist) -> Float64Array:
    """Return the (4,) wheel rates that the base commands, by its own effective track."""
    half = twist.yaw_rate_rad_s * jackal.EFFECTIVE_TRACK_M / 2.0
    left, right = twist.speed_m_s - half, twist.speed_m_s + half
    return np.array([left, left, right, right]) / jackal.WHEEL_RADIUS_M


def _streams(motion: Motion, seed: int, options: DriveOptions) -> tuple[DeviceStream, ...]:
    """Return all devices' streams; each device has random numbers of its own."""
    vibration, gyro, wheels, mocap = (np.random.default_rng([seed, i]) for i in range(4))
    faults, sensor = options.faults, options.accelerometer
    signal = accelerometer_signal(motion, sensor, faults, vibration)
    return (
        acceleration_stream(motion, sensor, signal, faults, vibration),
        vibration_stream(motion, sensor, signal, options.vibration, faults, vibration),
        gyro_stream(motion, options.gyro, faults, gyro),
        *wheel_streams(motion, options.wheels, faults, wheels),
        pose_stream(motion, options.mocap, faults, mocap),
    )
