"""Acceleration of a vibration of which only amplitude and frequency are known."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from drivers.samples import Float64Array, VibrationQuantity, VibrationStatistic

# Power of the angular frequency between the quantity and acceleration.
_DERIVATIVES: Mapping[VibrationQuantity, int] = {
    "displacement": 2,
    "velocity": 1,
    "acceleration": 0,
}
# Factor from the statistic to the peak of a sine.
_PEAK: Mapping[VibrationStatistic, float] = {
    "peak": 1.0,
    "peak-to-peak": 0.5,
    "rms": float(np.sqrt(2.0)),
    "instantaneous": np.nan,
}


def acceleration_m_s2(
    amplitude: ArrayLike,
    frequency_hz: ArrayLike,
    quantity: VibrationQuantity,
    statistic: VibrationStatistic,
    band_hz: tuple[float, float] = (0.0, np.inf),
) -> Float64Array:
    """Return the peak acceleration of a single tone, m/s^2, elementwise.

    a = (2 pi f)^2 d = 2 pi f v, with d and v the peaks of displacement and velocity: half of
    peak-to-peak, sqrt(2) times RMS. It holds for one sine per axis. For a mixture of tones, or
    shocks, the sensor names one frequency and the result is not the acceleration of the axis.

    Args:
        amplitude: (...,) in m, m/s or m/s^2.
        frequency_hz: (...,) of the tone, Hz.
        quantity: what `amplitude` is an amplitude of.
        statistic: which amplitude it is; an instantaneous value has none, the result is NaN.
        band_hz: lowest and highest frequency for which the sensor is valid (its profile's
            `band_hz`); outside, the result is NaN.
    """
    frequency = np.asarray(frequency_hz, dtype=np.float64)
    in_band = (frequency >= band_hz[0]) & (frequency <= band_hz[1])
    omega_rad_s = np.where(in_band, 2.0 * np.pi * frequency, np.nan)
    peak = np.asarray(amplitude, dtype=np.float64) * _PEAK[statistic]
    # At the power 0 a NaN outside the band would vanish: NaN ** 0 is 1.
    factor = np.where(in_band, omega_rad_s ** _DERIVATIVES[quantity], np.nan)
    return np.asarray(peak * factor)
