"""Self-affine ground: a random surface whose roughness grows with scale as on the Moon.

The RMS height difference at a baseline L (the deviogram of Shepard et al. 2001) grows as L^H with
H = 0.85 below 20 cm and H = 0.65 up to some metres; Helfenstein and Shepard 1999 found 0.5-0.7
below centimetres. A surface with the spectrum S(k) = A k^(-2 h - 2), k in cycles per metre, has
H = h only when that law holds at all scales. The exponents h and the break between them are those
that give H in the deviogram of a spectrum that ends at 20 m.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.special import j0, spherical_jn

Float64Array = NDArray[np.float64]

FINE_EXPONENT = 0.85
COARSE_EXPONENT = 0.65
# The median length of a gradient whose two components are Gaussian with unit deviation.
MEDIAN_OF_GRADIENT = float(np.sqrt(2.0 * np.log(2.0)))

_SPECTRAL_FINE = 1.25
_SPECTRAL_COARSE = 0.75
_BREAK_M = 0.4
_LARGEST_M = 20.0
_SLOPE_BASELINE_M = 0.02


def spectrum_shape(k_per_m: Float64Array) -> Float64Array:
    """Return the power spectrum for wave numbers in cycles per metre, 1 at the break."""
    relative = np.maximum(k_per_m, 1.0 / _LARGEST_M) * _BREAK_M
    exponent = np.where(relative < 1.0, _SPECTRAL_COARSE, _SPECTRAL_FINE)
    return np.asarray(relative ** (-2.0 * exponent - 2.0), np.float64)


def spectrum_scale(median_slope_rad: float) -> float:
    """Return the factor of `spectrum_shape` in m^4 that gives a median slope at 2 cm baseline.

    The mean square height difference at a distance L is the integral of
    S(k) (2 - 2 J0(2 pi k L)) over the plane of wave numbers.
    """
    k = np.geomspace(1e-3, 1e5, 20_001)
    weight = 2.0 - 2.0 * j0(2.0 * np.pi * k * _SLOPE_BASELINE_M)
    difference2 = np.trapezoid(spectrum_shape(k) * weight * 2.0 * np.pi * k * k, np.log(k))
    wanted = np.tan(median_slope_rad) / MEDIAN_OF_GRADIENT * _SLOPE_BASELINE_M
    return float(wanted**2 / difference2)


def expected_rms_height_m(window_m: float, median_slope_rad: float) -> float:
    """Return the RMS height above the mean plane of square windows of an endless surface.

    A wave keeps what its mean (j0) and its slopes (sqrt(3) j1) over the window leave of it.
    """
    k = np.geomspace(0.05 / window_m, 1e3 / window_m, 401)[:, np.newaxis]
    heading = np.linspace(0.0, 0.5 * np.pi, 181)
    u, v = np.pi * k * window_m * np.cos(heading), np.pi * k * window_m * np.sin(heading)
    mean_u, mean_v = spherical_jn(0, u) ** 2, spherical_jn(0, v) ** 2
    slope_u, slope_v = spherical_jn(1, u) ** 2, spherical_jn(1, v) ** 2
    left = 1.0 - mean_u * mean_v - 3.0 * (slope_u * mean_v + mean_u * slope_v)
    density = spectrum_shape(k) * 2.0 * np.pi * k**2 * left.mean(axis=1, keepdims=True)
    scale = spectrum_scale(median_slope_rad)
    return float(np.sqrt(scale * np.trapezoid(density[:, 0], np.log(k[:, 0]))))


def rough_ground(
    shape: tuple[int, int],
    spacing_m: float,
    median_slope_rad: float,
    random: np.random.Generator,
) -> Float64Array:
    """Return (rows, columns) heights of a self-affine surface around zero, metres.

    Args:
        shape: rows and columns.
        spacing_m: distance of the nodes.
        median_slope_rad: of the gradient over a baseline of 2 cm.
        random: the source of the surface; same state, same surface.
    """
    padded = [fft.next_fast_len(nodes, real=True) for nodes in shape]
    k_y = fft.fftfreq(padded[0], spacing_m)[:, np.newaxis]
    k_x = fft.rfftfreq(padded[1], spacing_m)[np.newaxis, :]
    spectrum = spectrum_scale(median_slope_rad) * spectrum_shape(np.hypot(k_x, k_y))
    spectrum[0, 0] = 0.0
    white = fft.rfft2(random.standard_normal(padded))
    heights = fft.irfft2(white * (np.sqrt(spectrum) / spacing_m), s=padded)
    return np.asarray(heights[: shape[0], : shape[1]], np.float64)
