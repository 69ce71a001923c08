"""By how much one sensor's stamps are later than another's, from a motion that both see.

Both tell the yaw rate, b(t) = g a(t - d) + o. Resampled to 1 kHz and smoothed by one and the same
filter, so that noise does not depend on where a shift falls between samples, the two are brought
to match by least squares over d, g and o. The uncertainty is that of a sandwich whose pieces are
seconds of the recording: noise that neighbours share, and motion that the two see differently,
widen it. Where one of them has a gap, nothing is compared.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.stats import t as student

from calibration_rigs.errors import RigError
from calibration_rigs.static_rig.gaps import away_from, bridged, gaps_of

Float64Array = NDArray[np.float64]

_STEP_S = 1e-3
# Hand-turned rovers move below 3 Hz, which this passes; it averages several samples of 50 Hz.
_SMOOTH_S = 0.03
_LARGEST_S = 0.5
_PIECE_S = 1.0
_PIECES_AT_LEAST = 10
_CORRELATION_AT_LEAST = 0.8
_STEPS_AT_MOST = 20
# A sensor that says nothing else all the time has nothing but rounding left.
_STILL_RAD_S = 1e-9
_THREE_SIGMA = 0.99865


@dataclass(frozen=True, slots=True)
class YawRate:
    """One sensor's yaw rate: (n,) times in seconds, increasing, and rates in rad/s."""

    t_s: Float64Array
    rate_rad_s: Float64Array


@dataclass(frozen=True, slots=True)
class Delay:
    """What two sensors' rates say.

    Attributes:
        delay_s: later by; negative = the reference is the later one.
        sigma_s: a third of the half width that holds the truth in 99.73 of 100 recordings.
        gain: rate over the reference's; negative = its axis points the other way.
        correlation: of the two after the shift.
        duration_s: of the motion used, without what is lost at gaps.
    """

    delay_s: float
    sigma_s: float
    gain: float
    correlation: float
    duration_s: float


def relative_delay(reference: YawRate, other: YawRate) -> Delay:
    """Return by how much `other` is later than `reference`.

    Raises:
        RigError: they overlap for less than ten seconds, or do not see the same motion.
    """
    first = max(float(reference.t_s[0]), float(other.t_s[0]))
    last = min(float(reference.t_s[-1]), float(other.t_s[-1]))
    grid = _grid(reference, other, first, last)
    wide = np.arange(first, last, _STEP_S)
    a = CubicSpline(wide, _smooth(reference, wide))
    b = np.interp(grid, wide, _smooth(other, wide))
    if min(float(np.std(a(grid))), float(np.std(b))) < _STILL_RAD_S:
        raise RigError(
            "one of them tells the same rate all the time; expected the rover to be turned to and "
            "fro by hand, and wheels that turn with it"
        )
    delay_s = _coarse(a, b, grid)
    for _ in range(_STEPS_AT_MOST):
        step_s, _, _, _ = _match(a, b, grid, delay_s)
        delay_s += step_s
        if abs(step_s) < 1e-8 or abs(delay_s) > _LARGEST_S:
            break
    _, gain, across, residual = _match(a, b, grid, delay_s)
    correlation = math.sqrt(max(1.0 - float(np.var(residual) / np.var(b)), 0.0))
    if correlation < _CORRELATION_AT_LEAST or abs(delay_s) > _LARGEST_S:
        raise RigError(
            f"the two rates agree to a correlation of {correlation:.2f} at {1e3 * delay_s:.0f} ms; "
            f"expected {_CORRELATION_AT_LEAST} within {1e3 * _LARGEST_S:.0f} ms: turn the rover to "
            "and fro by hand, about once a second, and not by equal strokes"
        )
    sigma_s = _sigma_s(across, residual)
    return Delay(delay_s, sigma_s, gain, correlation, float(grid.size * _STEP_S))


def _grid(reference: YawRate, other: YawRate, first: float, last: float) -> Float64Array:
    """Return the times at which the two are compared: away from their ends and gaps.

    Raises:
        RigError: they are too few.
    """
    reach_s = 4.0 * _SMOOTH_S
    margin_s = _LARGEST_S + reach_s
    grid = np.arange(first + margin_s, last - margin_s, _STEP_S)
    whole = grid.size
    grid = away_from(grid, gaps_of(reference.t_s), margin_s)
    grid = away_from(grid, gaps_of(other.t_s), reach_s)
    if grid.size * _STEP_S < _PIECES_AT_LEAST * _PIECE_S:
        lost = f", {(whole - grid.size) * _STEP_S:.1f} s of it at gaps" if grid.size < whole else ""
        raise RigError(
            f"the sensors overlap for {max(last - first, 0.0):.1f} s{lost}; expected at least "
            f"{_PIECES_AT_LEAST * _PIECE_S + 2.0 * margin_s:.0f} s of turning to and fro by hand"
        )
    return grid


def _smooth(signal: YawRate, grid: Float64Array) -> Float64Array:
    """Return the rate on the grid, smoothed without shift."""
    plain = CubicSpline(*bridged(signal.t_s, signal.rate_rad_s))(grid)
    return np.asarray(gaussian_filter1d(plain, _SMOOTH_S / _STEP_S), np.float64)


def _coarse(a: CubicSpline, b: Float64Array, grid: Float64Array) -> float:
    """Return the shift, to 5 ms, at which the two resemble each other most, with either sign."""
    some = slice(None, None, 5)
    shifts = np.arange(-_LARGEST_S, _LARGEST_S + 1e-9, 5e-3)
    alike = [abs(np.corrcoef(a(grid[some] - shift), b[some])[0, 1]) for shift in shifts]
    return float(shifts[int(np.argmax(alike))])


def _match(
    a: CubicSpline, b: Float64Array, grid: Float64Array, delay_s: float
) -> tuple[float, float, Float64Array, Float64Array]:
    """Return what is missing of the delay, the gain, and two series for the uncertainty.

    These are the derivative by the delay with gain and offset taken out, and what is left of b.
    """
    at = grid - delay_s
    columns = np.column_stack([a(at), np.ones_like(grid)])
    solved = np.linalg.lstsq(columns, np.column_stack([b, a(at, 1)]), rcond=None)[0]
    residual = b - columns @ solved[:, 0]
    gain = float(solved[0, 0])
    across = -gain * (a(at, 1) - columns @ solved[:, 1])
    size = float(across @ across)
    step_s = float(across @ residual) / size if size > 0.0 else math.inf
    return step_s, gain, across, residual


def _sigma_s(across: Float64Array, residual: Float64Array) -> float:
    """Return sigma of the delay from how differently the seconds of the recording vote.

    As in `calibration_rigs.plate_rig.quantised`: each vote by 1 - h, and Student's t.
    """
    pieces = int(across.size * _STEP_S / _PIECE_S)
    parts = np.array_split(np.arange(across.size), pieces)
    size = float(across @ across)
    share = np.array([float(across[part] @ across[part]) for part in parts]) / size
    votes = np.array([float(across[part] @ residual[part]) for part in parts]) / size
    sigma_s = float(np.sqrt(np.sum(votes**2 / np.maximum(1.0 - share, 0.1))))
    degrees = max(1.0 / float(share @ share) - 1.0, 1.0)
    return sigma_s * float(student.ppf(_THREE_SIGMA, degrees)) / 3.0
