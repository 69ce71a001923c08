"""What the accelerometer inside the vibration sensor measures of a motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from drivers.samples import AccelerationSample, Sample, frozen_array
from simulation.devices.device_stream import DeviceClock, DeviceStream
from simulation.faults import AccelerometerBias, Fault, arriving
from simulation.motion import Motion
from simulation.vehicle.jackal import WHEEL_RADIUS_M

Float64Array = NDArray[np.float64]
Int64Array = NDArray[np.int64]
Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Accelerometer:
    """Triaxial accelerometer inside the vibration sensor.

    Noise is that of a good MEMS chip (200 ug/rtHz); the bias is what levelling with it leaves,
    about 0.12 degrees. The drivetrain's hum is an assumption: a tone of every wheel at multiples
    of its rate (24 turns of the motor per turn of the wheel), growing with the speed.

    Attributes:
        position_m: where it is in frame R.
        rotation_rad: (3,) rotation vector from its axes to R's.
        clock: how it keeps time.
        noise_density_m_s2: white noise, m/s^2/rtHz.
        bias_sigma_m_s2: standard deviation of each axis' constant bias, drawn once a run.
        quantum_m_s2: of the digital value; 16 g / 32768.
        bits: width of that value, two's complement; it saturates.
        hum: per tone, turns per turn of the wheel and amplitude in m/s^2 per m/s of the rim.
    """

    position_m: Vector = (0.05, 0.0, 0.10)
    rotation_rad: Vector = (0.0, 0.0, 0.0)
    clock: DeviceClock = field(
        default_factory=lambda: DeviceClock(1000.0, drift_ppm=35.0, latency_s=0.004, jitter_s=2e-4)
    )
    noise_density_m_s2: float = 0.002
    bias_sigma_m_s2: float = 0.02
    quantum_m_s2: float = 16.0 * 9.80665 / 32768.0
    bits: int = 16
    hum: tuple[tuple[float, float], ...] = ((24.0, 0.2), (72.0, 0.2))


@dataclass(frozen=True, slots=True)
class AccelerometerSignal:
    """What the chip measured.

    Attributes:
        edges_ns: (N + 1,) true times; sample k is the mean between edges k and k + 1.
        acceleration_m_s2: (N, 3) in the sensor's axes, quantised.
    """

    edges_ns: Int64Array
    acceleration_m_s2: Float64Array


def accelerometer_signal(
    motion: Motion, settings: Accelerometer, faults: Sequence[Fault], random: np.random.Generator
) -> AccelerometerSignal:
    """Return specific force with hum, bias, noise and quantisation."""
    edges = settings.clock.edges_ns(motion.start_ns, motion.duration_ns, random)
    body = motion.mean_acceleration(edges) + _hum(motion, settings, edges[1:], random)
    sensor = Rotation.from_rotvec(settings.rotation_rad).inv().apply(body)
    sensor += settings.bias_sigma_m_s2 * random.standard_normal(3)
    sigma = settings.noise_density_m_s2 * math.sqrt(settings.clock.rate_hz / 2.0)
    sensor += sigma * random.standard_normal(sensor.shape)
    elapsed_s = motion.elapsed_s(edges[1:])
    for fault in faults:
        if isinstance(fault, AccelerometerBias):
            inside = (elapsed_s >= fault.start_s) & (elapsed_s < fault.start_s + fault.duration_s)
            sensor[inside] += fault.bias_m_s2
    top = 2 ** (settings.bits - 1)
    # A register knows no negative zero; adding 0 makes it a positive one.
    counts = np.clip(np.rint(sensor / settings.quantum_m_s2), -top, top - 1) + 0.0
    return AccelerometerSignal(edges, counts * settings.quantum_m_s2)


def _hum(
    motion: Motion, settings: Accelerometer, t_ns: Int64Array, random: np.random.Generator
) -> Float64Array:
    """Return (N, 3) vibration of the drivetrain; every wheel and axis has its own phase."""
    hum = np.zeros((t_ns.size, 3))
    angles = motion.wheel_angles_at(t_ns)
    speeds = np.abs(motion.wheel_rates_at(t_ns)) * WHEEL_RADIUS_M
    for order, amplitude in settings.hum:
        phases = random.uniform(0.0, 2.0 * math.pi, (4, 3))
        for wheel, axis in np.ndindex(4, 3):
            phase = order * angles[:, wheel] + phases[wheel, axis]
            hum[:, axis] += amplitude * speeds[:, wheel] * np.sin(phase)
    return hum


def acceleration_stream(
    motion: Motion,
    settings: Accelerometer,
    signal: AccelerometerSignal,
    faults: Sequence[Fault],
    random: np.random.Generator,
) -> DeviceStream:
    """Return the specific force as samples."""
    measured_ns = signal.edges_ns[1:]
    t_ns = settings.clock.stamps_ns(measured_ns, random)

    def make(index: int, sequence: int) -> Sample:
        """Return that sample; specific force in the sensor's axes, m/s^2."""
        values = frozen_array(signal.acceleration_m_s2[index], (3,))
        return AccelerationSample(int(t_ns[index]), values, sequence)

    arrived = arriving(faults, "vibration", motion.elapsed_s(measured_ns), random)
    return DeviceStream("vibration", AccelerationSample, measured_ns, arrived, make)
