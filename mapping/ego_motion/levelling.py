"""Roll and pitch from the direction of gravity, in a window that reaches to both sides of a time.

A chip at rest measures f = C_RT g e_z = g (-sin p, cos p sin r, cos p cos r). Of the accelerations
around a time a line is fitted (weights of Hann's window), after what the rover's own motion adds
has been taken off: v' along x, v turn along y. A filter that knows the past alone lags behind a
moving chassis or lets the vibration through; 0.4 s to either side cost 0.4 s of waiting.

The sigma is a share of the scatter about the line: where the chassis rocks more, its slow
accelerations, which no window can tell from gravity, are larger too. The share is measured on
simulated drives and checked on a real robot (docs/ego_motion.md).
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from mapping.geometry import Float64Array

# A window that holds less than this share of its weight says nothing about the tilt.
_LEAST_SHARE = 0.2


@dataclass(frozen=True, slots=True)
class Levelled:
    """Tilt at N ticks.

    Attributes:
        roll_rad, pitch_rad, roll_rate_rad_s, pitch_rate_rad_s: (N,); rates are those of the
            angles.
        roll_sigma_rad, pitch_sigma_rad: (N,) without the constant bias; NaN with all others
            where there was too little to see.
    """

    roll_rad: Float64Array
    pitch_rad: Float64Array
    roll_rate_rad_s: Float64Array
    pitch_rate_rad_s: Float64Array
    roll_sigma_rad: Float64Array
    pitch_sigma_rad: Float64Array

    def inner(self, ends: int) -> Levelled:
        """Return the tilt without so many ticks at either end."""
        return Levelled(*(getattr(self, f.name)[ends:-ends] for f in fields(self)))


def level(
    force_m_s2: Float64Array,
    weight: Float64Array,
    half: int,
    tick_s: float,
    sigma_ratio: float,
    floor_rad: float,
) -> Levelled:
    """Return the tilt at the ticks that have `half` blocks on either side.

    Args:
        force_m_s2: (N + 2 half, 3) specific force without the rover's own acceleration.
        weight: (N + 2 half,) 0 for blocks to leave out, else 1.
        half: blocks on either side.
        tick_s: distance of the blocks.
        sigma_ratio, floor_rad: see `EgoMotionSettings`.
    """
    mean, slope, scatter, share = fit_lines(force_m_s2, weight, half)
    size = np.linalg.norm(mean, axis=1)
    known = (share > _LEAST_SHARE) & (size > 0.0)
    safe = np.where(known, size, np.nan)
    pitch = -np.arcsin(mean[:, 0] / safe)
    roll = np.where(known, np.arctan2(mean[:, 1], mean[:, 2]), np.nan)
    down = safe * np.cos(pitch)
    sigma = np.sqrt(sigma_ratio**2 * scatter / safe[:, None] ** 2 / share[:, None] + floor_rad**2)
    return Levelled(
        roll_rad=roll,
        pitch_rad=pitch,
        roll_rate_rad_s=slope[:, 1] / down / tick_s,
        pitch_rate_rad_s=-slope[:, 0] / down / tick_s,
        roll_sigma_rad=sigma[:, 1],
        pitch_sigma_rad=sigma[:, 0],
    )


def sway(angle_rad: Float64Array, half: int) -> Float64Array:
    """Return (N,) the variance of an angle around a time, by Hann's window, without the mean.

    Args:
        angle_rad: (N + 2 half,); what is NaN does not count.
        half: ticks on either side.
    """
    hann = 0.5 * (1.0 + np.cos(np.pi * np.arange(-half, half + 1.0) / (half + 1)))
    around = sliding_window_view(angle_rad, 2 * half + 1)
    weight = np.isfinite(around) * hann
    total = np.maximum(weight.sum(axis=1), 1e-9)
    known = np.nan_to_num(around)
    mean = (weight * known).sum(axis=1) / total
    variance = (weight * (known - mean[:, np.newaxis]) ** 2).sum(axis=1) / total
    return np.asarray(variance, np.float64)


def fit_lines(
    values: Float64Array, weight: Float64Array, half: int
) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array]:
    """Fit a line to the values around every block that has `half` neighbours on either side.

    Returns:
        value (N, A) and slope per block (N, A) in the middle, variance about the line (N, A), and
        the share (N,) of the window's weight that was there; NaN where nothing was.
    """
    place = np.arange(-half, half + 1.0)
    hann = 0.5 * (1.0 + np.cos(np.pi * place / (half + 1)))
    w = sliding_window_view(weight, 2 * half + 1) * hann
    y = sliding_window_view(values, 2 * half + 1, axis=0)
    s0, s1, s2 = w.sum(axis=1), w @ place, w @ place**2
    wy = w[:, np.newaxis, :] * y
    y0, y1, y2 = wy.sum(axis=2), wy @ place, (wy * y).sum(axis=2)
    share = s0 / hann.sum()
    s0, s1, s2, share = (np.where(s0 > 0.0, s, np.nan) for s in (s0, s1, s2, share))
    centre = s1 / s0
    spread = s2 / s0 - centre**2
    mean = y0 / s0[:, np.newaxis]
    slope = np.divide(
        y1 / s0[:, np.newaxis] - centre[:, np.newaxis] * mean,
        spread[:, np.newaxis],
        out=np.zeros_like(mean),
        where=spread[:, np.newaxis] > 1e-9,
    )
    variance = y2 / s0[:, np.newaxis] - mean**2 - slope**2 * spread[:, np.newaxis]
    middle = mean - slope * centre[:, np.newaxis]
    return middle, slope, np.maximum(variance, 0.0), share
