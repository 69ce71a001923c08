"""How many pixels share one noise draw: the summed autocorrelation of what is off the plane."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, next_fast_len, rfft2

Float64Array = NDArray[np.float64]
FloatArray = NDArray[np.float32] | Float64Array

# Noise of depth cameras is alike over less than this.
_REACH_PX = 12
# Readings that all are the same have no noise to share; what is left is rounding.
_STILL_PX2 = 1e-12


def correlation_area_px(residual: FloatArray) -> float:
    """Return 1 + the sum of the autocorrelation over all lags up to 12 px; at least 1.

    n neighbouring pixels are worth n / area independent ones.

    Args:
        residual: (frames, height, width) deviations from the plane, pixels; NaN = none.
    """
    there = np.isfinite(residual)
    if np.count_nonzero(there) < 100:
        return 1.0
    flat = np.where(there, residual - np.nanmean(residual), 0.0)
    shape = [next_fast_len(n + _REACH_PX, real=True) for n in residual.shape[1:]]
    products = _correlate(flat, shape)
    pairs = _correlate(there.astype(flat.dtype), shape)
    with np.errstate(invalid="ignore", divide="ignore"):
        covariance = np.where(pairs > 50.0, products / pairs, 0.0)
    variance = covariance[_REACH_PX, _REACH_PX]
    if not variance > _STILL_PX2:
        return 1.0
    rho = covariance / variance
    v, u = np.ogrid[-_REACH_PX : _REACH_PX + 1, -_REACH_PX : _REACH_PX + 1]
    ring = np.rint(np.hypot(u, v)).astype(int)
    means = np.bincount(ring.ravel(), rho.ravel()) / np.bincount(ring.ravel())
    # Beyond the first ring without correlation there is only noise to add up.
    none = np.flatnonzero(means[: _REACH_PX + 1] < 0.02)
    reach = int(none[0]) if none.size else _REACH_PX + 1
    return max(1.0, float(rho[ring < reach].sum()))


def _correlate(layers: FloatArray, shape: list[int]) -> Float64Array:
    """Return (2 reach + 1, 2 reach + 1): the autocorrelation at small lags, summed over layers."""
    spectrum = np.abs(rfft2(layers, shape, axes=(1, 2))) ** 2
    whole = irfft2(spectrum.sum(axis=0), shape)
    rolled = np.roll(whole, (_REACH_PX, _REACH_PX), axis=(0, 1))
    near: Float64Array = rolled[: 2 * _REACH_PX + 1, : 2 * _REACH_PX + 1]
    return near
