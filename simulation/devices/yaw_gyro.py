"""What a yaw gyro reports of a motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from drivers.samples import Sample, YawRateSample
from simulation.devices.device_stream import DeviceClock, DeviceStream
from simulation.faults import Fault, arriving
from simulation.motion import Motion

Float64Array = NDArray[np.float64]
Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Warming:
    """A chip that warms up: T = start + rise (1 - exp(-t / time)), degrees Celsius and s."""

    start_c: float = 22.0
    rise_c: float = 8.0
    time_s: float = 300.0

    def at(self, elapsed_s: Float64Array) -> Float64Array:
        """Return the temperatures at times after the start of the run."""
        return self.start_c + self.rise_c * -np.expm1(-elapsed_s / self.time_s)


@dataclass(frozen=True, slots=True)
class Gyro:
    """Single-axis yaw gyro: an Epson XV7001BB's register with an average MEMS chip's errors.

    Attributes:
        rotation_rad: (3,) rotation vector from its axes to R's; it senses its z axis.
        clock: how it keeps time; 200 to 400 Hz are usual.
        noise_density_rad_s: white noise, rad/s/rtHz.
        bias_sigma_rad_s: standard deviation of the constant bias, drawn once a run.
        bias_walk_rad_s: random walk of the bias, rad/s per root second.
        bias_per_c: change of the bias with temperature, rad/s per degree from 25 C.
        warming: the chip's temperature, which it reports in steps of 1/16 degree.
        temperature_period_s: how often the temperature is read; the samples between keep it.
        deg_s_per_count: scale of the register.
        bits: width of the register, two's complement.
    """

    rotation_rad: Vector = (0.0, 0.0, 0.0)
    clock: DeviceClock = field(
        default_factory=lambda: DeviceClock(200.0, drift_ppm=-60.0, latency_s=8e-4, jitter_s=1e-4)
    )
    noise_density_rad_s: float = 8.7e-5
    bias_sigma_rad_s: float = 0.01
    bias_walk_rad_s: float = 2e-5
    bias_per_c: float = 1e-4
    warming: Warming = field(default_factory=Warming)
    temperature_period_s: float = 1.0
    deg_s_per_count: float = 1.0 / 71680.0
    bits: int = 24


def gyro_stream(
    motion: Motion, settings: Gyro, faults: Sequence[Fault], random: np.random.Generator
) -> DeviceStream:
    """Return the rate about the sensing axis, mean over every period, as samples."""
    clock = settings.clock
    edges = clock.edges_ns(motion.start_ns, motion.duration_ns, random)
    measured_ns = edges[1:]
    elapsed_s = motion.elapsed_s(measured_ns)
    axis = Rotation.from_rotvec(settings.rotation_rad).as_matrix()[:, 2]
    celsius = settings.warming.at(elapsed_s)
    rate = motion.mean_body_rate(edges) @ axis + _gyro_errors(settings, celsius, random)
    top = 2 ** (settings.bits - 1)
    counts = np.clip(np.rint(np.degrees(rate) / settings.deg_s_per_count), -top, top - 1)
    every = max(round(settings.temperature_period_s * clock.rate_hz), 1)
    shown_c = (np.rint(16.0 * celsius) / 16.0)[np.arange(celsius.size) // every * every]
    t_ns = clock.stamps_ns(measured_ns, random)

    def make(index: int, sequence: int) -> Sample:
        """Return that sample, as coarse as the chip's counts."""
        raw = int(counts[index])
        rate_rad_s = math.radians(raw * settings.deg_s_per_count)
        return YawRateSample(int(t_ns[index]), rate_rad_s, float(shown_c[index]), raw, sequence)

    arrived = arriving(faults, "gyro", elapsed_s, random)
    return DeviceStream("gyro", YawRateSample, measured_ns, arrived, make, counts_lost=True)


def _gyro_errors(
    settings: Gyro, celsius: Float64Array, random: np.random.Generator
) -> Float64Array:
    """Return (N,) bias with its walk and temperature, and white noise, rad/s."""
    rate_hz, count = settings.clock.rate_hz, celsius.size
    bias = settings.bias_sigma_rad_s * random.standard_normal()
    walk = np.cumsum(random.standard_normal(count)) * settings.bias_walk_rad_s / math.sqrt(rate_hz)
    sigma = settings.noise_density_rad_s * math.sqrt(rate_hz / 2.0)
    white = sigma * random.standard_normal(count)
    return np.asarray(bias + walk + settings.bias_per_c * (celsius - 25.0) + white, np.float64)
