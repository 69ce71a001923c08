"""Amplitude and frequency of a vibration, as a sensor reports them window by window.

Of the last window of accelerations, each axis without its mean and slope, in the sensor's band:

    f = the highest peak of the Hann-windowed spectrum, between bins by a parabola
    a = sqrt(2) RMS of all that is in the band, as if one tone carried it
    d = a / (2 pi f)^2,  v = a / (2 pi f)

Which window a real sensor uses, and whether its amplitude is that of the strongest tone alone,
no maker tells; this form keeps the energy.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from drivers.samples import (
    Sample,
    VibrationQuantity,
    VibrationSample,
    VibrationStatistic,
    frozen_array,
)
from simulation.devices.accelerometer import Accelerometer, AccelerometerSignal
from simulation.devices.device_stream import DeviceStream
from simulation.devices.yaw_gyro import Warming
from simulation.errors import SimulationError
from simulation.faults import Fault, arriving
from simulation.motion import Motion

Float64Array = NDArray[np.float64]

# Power of 2 pi f between acceleration and the quantity.
_INTEGRALS: Mapping[VibrationQuantity, int] = {"displacement": 2, "velocity": 1, "acceleration": 0}
# Factor from a sine's peak to the statistic.
_FROM_PEAK: Mapping[VibrationStatistic, float] = {
    "peak": 1.0,
    "peak-to-peak": 2.0,
    "rms": math.sqrt(0.5),
}
_CELSIUS_STEP = 0.01
_BLOCK = 500  # windows at a time: 9 MB of spectra


@dataclass(frozen=True, slots=True)
class VibrationOutput:
    """What the sensor makes of its accelerations; the defaults are the profile `aft601d`.

    Attributes:
        rate_hz: samples per second; the accelerometer's rate over this is rounded.
        window_s: length of the windows.
        band_hz: lowest and highest frequency that it looks at.
        quantity: what the amplitude is an amplitude of.
        statistic: which one; not "instantaneous".
        amplitude_quantum: step of the amplitude, m, m/s or m/s^2.
        frequency_quantum_hz: step of the frequency.
        largest_count: an amplitude or frequency of more steps has no value (NaN).
        warming: the device's temperature, reported in steps of 0.01 degree.
        offset_s: what the device's clock shows at the start of the run.
        tick_s: its resolution.
        wrap_ticks: it starts again from 0 here.
    """

    rate_hz: float = 100.0
    window_s: float = 0.256
    band_hz: tuple[float, float] = (5.0, 500.0)
    quantity: VibrationQuantity = "displacement"
    statistic: VibrationStatistic = "peak"
    amplitude_quantum: float = 1e-7
    frequency_quantum_hz: float = 0.1
    largest_count: int = 2**16 - 2
    warming: Warming = field(default_factory=Warming)
    offset_s: float = 4200.0
    tick_s: float = 1e-6
    wrap_ticks: int = 2**32

    def __post_init__(self) -> None:
        if self.statistic not in _FROM_PEAK:
            raise SimulationError(
                f"a vibration statistic {self.statistic!r}; expected {', '.join(_FROM_PEAK)}"
            )
        if not (0.05 <= self.window_s <= 10.0 and 0.0 < self.rate_hz <= 1000.0):
            raise SimulationError(
                f"window_s {self.window_s}, rate_hz {self.rate_hz}; expected 0.05 to 10 s and "
                "up to 1000 Hz"
            )
        if not 0.0 < self.band_hz[0] < self.band_hz[1]:
            raise SimulationError(f"band_hz is {self.band_hz}; expected 0 < lowest < highest")


def amplitude_and_frequency(
    windows_m_s2: Float64Array, rate_hz: float, output: VibrationOutput
) -> tuple[Float64Array, Float64Array]:
    """Return amplitudes and frequencies (Hz) of windows along the last axis, not quantised.

    Args:
        windows_m_s2: (..., K) accelerations.
        rate_hz: at which they were measured.
        output: band, quantity and statistic.
    """
    count = windows_m_s2.shape[-1]
    hann = np.hanning(count + 1)[:-1]
    spectrum = np.abs(np.fft.rfft(_without_trend(windows_m_s2) * hann))
    bins = np.fft.rfftfreq(count, 1.0 / rate_hz)
    outside = (bins < output.band_hz[0]) | (bins > output.band_hz[1])
    outside[0] = outside[-1] = True  # a peak needs a neighbour on either side
    spectrum[..., outside] = 0.0
    # Parseval: the mean square is twice the sum over positive frequencies, without the window.
    mean_square = 2.0 * (spectrum**2).sum(axis=-1) / (count * (hann**2).sum())
    frequency = _peak_bin(spectrum) * rate_hz / count
    peak = np.sqrt(2.0 * mean_square) / (2.0 * math.pi * frequency) ** _INTEGRALS[output.quantity]
    return peak * _FROM_PEAK[output.statistic], frequency


def _without_trend(windows: Float64Array) -> Float64Array:
    """Return windows less their least-squares line."""
    time = np.arange(windows.shape[-1]) - (windows.shape[-1] - 1) / 2.0
    slope = windows @ time / (time @ time)
    centred = windows - windows.mean(axis=-1, keepdims=True)
    return np.asarray(centred - slope[..., np.newaxis] * time, np.float64)


def _peak_bin(spectrum: Float64Array) -> Float64Array:
    """Return the highest peaks of (..., F) spectra, by a parabola through the logarithms."""
    top = spectrum.argmax(axis=-1).clip(1, spectrum.shape[-1] - 2)
    low, mid, high = (
        np.log(np.take_along_axis(spectrum, (top + k)[..., np.newaxis], -1)[..., 0] + 1e-30)
        for k in (-1, 0, 1)
    )
    bend = low - 2.0 * mid + high
    shift = np.divide(0.5 * (low - high), bend, out=np.zeros_like(bend), where=bend < 0.0)
    return np.asarray(top + np.clip(shift, -0.5, 0.5), np.float64)


def vibration_stream(
    motion: Motion,
    sensor: Accelerometer,
    signal: AccelerometerSignal,
    output: VibrationOutput,
    faults: Sequence[Fault],
    random: np.random.Generator,
) -> DeviceStream:
    """Return amplitude and frequency along the sensor's axes as samples."""
    rate_hz = sensor.clock.rate_hz
    length, stride = round(output.window_s * rate_hz), max(1, round(rate_hz / output.rate_hz))
    if len(signal.acceleration_m_s2) < length:
        raise SimulationError(f"the run is shorter than a vibration window of {output.window_s} s")
    windows = sliding_window_view(signal.acceleration_m_s2, length, axis=0)[::stride]
    blocks = [
        amplitude_and_frequency(windows[i : i + _BLOCK], rate_hz, output)
        for i in range(0, len(windows), _BLOCK)
    ]
    amplitude, frequency = (
        _quantised(np.vstack(part), step, output.largest_count)
        for part, step in zip(
            zip(*blocks, strict=True),
            (output.amplitude_quantum, output.frequency_quantum_hz),
            strict=True,
        )
    )
    measured_ns = signal.edges_ns[length::stride]
    elapsed_s = motion.elapsed_s(measured_ns)
    ticks = np.floor((output.offset_s + elapsed_s * sensor.clock.speed) / output.tick_s)
    celsius = np.rint(output.warming.at(elapsed_s) / _CELSIUS_STEP) * _CELSIUS_STEP
    t_ns = sensor.clock.stamps_ns(measured_ns, random)

    def make(index: int, sequence: int) -> Sample:
        """Return the sample of that window."""
        return VibrationSample(
            t_ns=int(t_ns[index]),
            amplitude=frozen_array(amplitude[index], (3,)),
            frequency_hz=frozen_array(frequency[index], (3,)),
            quantity=output.quantity,
            statistic=output.statistic,
            temperature_c=float(celsius[index]),
            sequence=sequence,
            device_ticks=int(ticks[index]) % output.wrap_ticks,
        )

    arrived = arriving(faults, "vibration", elapsed_s, random)
    return DeviceStream("vibration", VibrationSample, measured_ns, arrived, make)


def _quantised(values: Float64Array, step: float, largest_count: int) -> Float64Array:
    """Return whole steps, as a driver gets them from a register; NaN beyond the largest count."""
    counts = np.rint(values / step)
    return np.where(counts <= largest_count, counts * step, np.nan)
