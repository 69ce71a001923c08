"""Bias and scale of a yaw gyro: at rest, over temperature, and from turns of a known angle."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import trapezoid

from calibration_rigs.errors import RigError
from calibration_rigs.static_rig.allan import Coefficient
from calibration_rigs.static_rig.rest import Stretch

Float64Array = NDArray[np.float64]

_LEAST_TEMPERATURE_SPAN_C = 2.0
_BLOCK_S = 10.0


@dataclass(frozen=True, slots=True)
class TemperatureSlope:
    """How a bias follows the temperature.

    Attributes:
        at_middle: bias at `middle_c`, in the unit of the signal.
        per_c: change for a degree Celsius.
        middle_c, span_c: middle and extent of the temperatures seen; the line holds within them.
    """

    at_middle: Coefficient
    per_c: Coefficient
    middle_c: float
    span_c: float


@dataclass(frozen=True, slots=True)
class Turn:
    """A turn between two times of rest.

    Attributes:
        measured_rad: integral of the rate less the bias on both sides of the turn.
        sigma_rad: its standard deviation, from the noise of the biases and of the rate.
    """

    measured_rad: float
    sigma_rad: float


@dataclass(frozen=True, slots=True)
class GyroScale:
    """True angle = `scale` x measured angle.

    Attributes:
        scale: factor and its sigma.
        residual_rad: root mean square of what the turns leave unexplained.
        turns: how many.
    """

    scale: Coefficient
    residual_rad: float
    turns: int


def temperature_slope(
    t_s: Float64Array, values: Float64Array, temperature_c: Float64Array
) -> TemperatureSlope:
    """Fit a line through means of 10 s over temperature; all arrays (n,).

    Means of 10 s because neighbouring samples of a drifting bias are alike: the sigma comes from
    the scatter of the means.

    Raises:
        RigError: the temperature moved by less than 2 degrees, or too short a recording.
    """
    bias, temperature = _block_means(t_s, values), _block_means(t_s, temperature_c)
    span_c = float(np.ptp(temperature)) if len(temperature) else 0.0
    if len(bias) < 4 or span_c < _LEAST_TEMPERATURE_SPAN_C:
        raise RigError(
            f"{len(bias)} means of {_BLOCK_S:g} s over {span_c:.1f} degrees Celsius; expected at "
            f"least 4 over {_LEAST_TEMPERATURE_SPAN_C:g}: record from a cold start on"
        )
    middle_c = float(temperature.mean())
    design = np.stack([np.ones_like(bias), temperature - middle_c], axis=1)
    found, sigma = _line_fit(design, bias)
    return TemperatureSlope(
        Coefficient(float(found[0]), float(sigma[0])),
        Coefficient(float(found[1]), float(sigma[1])),
        middle_c,
        span_c,
    )


def turns_between(
    t_s: Float64Array, rate_rad_s: Float64Array, rests: Sequence[Stretch]
) -> list[Turn]:
    """Return the turn between each rest and the next.

    The bias is taken to change linearly from the mean of one rest to that of the next.
    """
    return [_turn(t_s, rate_rad_s, a, b) for a, b in itertools.pairwise(rests)]


def gyro_scale(turns: Sequence[Turn], true_rad: Sequence[float]) -> GyroScale:
    """Return the factor that makes the measured angles the true ones, weighting by their sigmas.

    The sigma is that of the weights, or that of the scatter where it is larger.

    Raises:
        RigError: as many angles as turns are needed, one at least, and none of them 0.
    """
    if len(turns) != len(true_rad) or not turns:
        raise RigError(
            f"{len(turns)} turns between times of rest and {len(true_rad)} known angles; expected "
            "as many of one as of the other: rest two seconds before and after each turn"
        )
    measured = np.array([turn.measured_rad for turn in turns])
    truth = np.array(true_rad, np.float64)
    if not np.all(measured * truth > 0.0):
        raise RigError(
            f"turns of {np.degrees(measured).round(1).tolist()} degrees measured for "
            f"{np.degrees(truth).round(1).tolist()}; expected the same signs and none 0: check "
            "their order and which way the sensing axis points"
        )
    weight = 1.0 / np.array([turn.sigma_rad for turn in turns]) ** 2
    information = float((weight * measured**2).sum())
    scale = float((weight * measured * truth).sum()) / information
    residual = truth - scale * measured
    freedom = max(len(turns) - 1, 1)
    misfit = max(float((weight * residual**2).sum()) / freedom, 1.0)
    return GyroScale(
        Coefficient(scale, (misfit / information) ** 0.5),
        float(np.sqrt(np.mean(residual**2))),
        len(turns),
    )


def _turn(t_s: Float64Array, rate_rad_s: Float64Array, before: Stretch, after: Stretch) -> Turn:
    biases, variances = zip(
        *(_mean_and_variance(rate_rad_s[s.first : s.end]) for s in (before, after)), strict=True
    )
    inside = slice(before.end - 1, after.first + 1)
    t, rate = t_s[inside], rate_rad_s[inside]
    duration_s = float(t[-1] - t[0])
    bias = np.interp(t, [t[0], t[-1]], biases)
    measured = float(trapezoid(rate - bias, t))
    from_biases = (duration_s / 2.0) ** 2 * sum(variances)
    noise = float(np.var(rate_rad_s[before.first : before.end], ddof=1))
    from_noise = noise * duration_s**2 / max(len(t), 1)
    return Turn(measured, float(np.sqrt(from_biases + from_noise)))


def _mean_and_variance(values: Float64Array) -> tuple[float, float]:
    return float(values.mean()), float(np.var(values, ddof=1)) / len(values)


def _block_means(t_s: Float64Array, values: Float64Array) -> Float64Array:
    """Return the means of successive blocks of 10 s; the last, incomplete one is left out."""
    block = np.floor((t_s - t_s[0]) / _BLOCK_S).astype(np.int64)
    whole = block < block[-1]
    count = np.bincount(block[whole])
    sums = np.bincount(block[whole], weights=values[whole])
    return np.asarray(sums[count > 0] / count[count > 0])


def _line_fit(design: Float64Array, values: Float64Array) -> tuple[Float64Array, Float64Array]:
    found, _, _, _ = np.linalg.lstsq(design, values, rcond=None)
    misfit = values - design @ found
    variance = float(misfit @ misfit) / (len(values) - design.shape[1])
    sigma = np.sqrt(np.diag(np.linalg.inv(design.T @ design)) * variance)
    return np.asarray(found), np.asarray(sigma)
