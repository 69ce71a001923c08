"""Noise of a sensor at rest by its overlapping Allan deviation, and the coefficients that make it.

sigma^2(tau) = 3 Q^2/tau^2 + N^2/tau + (2 ln 2/pi) B^2 + K^2 tau/3 (IEEE Std 952-1997, annex C).
The deviations are computed by allantools; their degrees of freedom and the fit are made here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import allantools
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from calibration_rigs.errors import RigError

Float64Array = NDArray[np.float64]

_POINTS_PER_DECADE = 8
# Deviations at neighbouring tau rest on the same samples: about three of eight points in a decade
# count as independent. Chosen so that the 95 % interval of N covers at least 95 % of simulations.
_POINTS_ALIKE = 3.0
_FLICKER = 2.0 * math.log(2.0) / math.pi


@dataclass(frozen=True, slots=True)
class AllanCurve:
    """Overlapping Allan deviation of one signal; arrays of the same length.

    Attributes:
        tau_s: averaging times.
        deviation: in the unit of the signal.
        degrees_of_freedom: of each deviation's square.
        duration_s: how long the signal was.
    """

    tau_s: Float64Array
    deviation: Float64Array
    degrees_of_freedom: Float64Array
    duration_s: float


@dataclass(frozen=True, slots=True)
class Coefficient:
    """A value and its standard deviation, in the same unit."""

    value: float
    sigma: float

    @property
    def is_significant(self) -> bool:
        """Whether the value differs from 0 by more than two of its sigma."""
        return self.value > 2.0 * self.sigma


@dataclass(frozen=True, slots=True)
class AllanFit:
    """What the noise is made of; [x] = unit of the signal.

    Attributes:
        quantisation: Q, [x] s.
        white: N, [x] / sqrt(Hz): the deviation at 1 s.
        instability: B, [x]: the flat part divided by 0.664.
        random_walk: K, [x] sqrt(Hz): the deviation at 3 s. A short recording makes it too large.
        chi2_per_freedom: misfit; far above 1, the signal is not such noise.
    """

    quantisation: Coefficient
    white: Coefficient
    instability: Coefficient
    random_walk: Coefficient
    chi2_per_freedom: float

    def deviation(self, tau_s: Float64Array) -> Float64Array:
        """Return the deviation that the coefficients make, (n,)."""
        values = (self.quantisation, self.white, self.instability, self.random_walk)
        squares = np.array([item.value**2 for item in values])
        return np.asarray(np.sqrt(_terms(tau_s) @ squares))


def allan_curve(
    values: Float64Array, rate_hz: float, tau_s: Float64Array | None = None
) -> AllanCurve:
    """Return the overlapping Allan deviation of a signal (n,) sampled at a constant rate.

    `tau_s`: averaging times, else eight a decade up to a fifth of the duration.

    Raises:
        RigError: too few samples, or one that is not a number.
    """
    require_signal(values, rate_hz)
    wished = averaging_times_s(len(values), rate_hz) if tau_s is None else tau_s
    tau, deviation, _, _ = allantools.oadev(values, rate=rate_hz, data_type="freq", taus=wished)
    averages = np.rint(tau * rate_hz)
    return AllanCurve(
        np.asarray(tau, np.float64),
        np.asarray(deviation, np.float64),
        _degrees_of_freedom(len(values), averages),
        len(values) / rate_hz,
    )


def fit_allan(curve: AllanCurve) -> AllanFit:
    """Fit the four coefficients to a curve, weighting each point by its degrees of freedom.

    The logarithm of the variance is fitted: its error, sqrt(2 / degrees of freedom), does not
    depend on the coefficients.

    Raises:
        RigError: the signal does not vary.
    """
    if not np.all(curve.deviation > 0.0):
        raise RigError(
            "the signal does not vary over some averaging times; expected noise, check that the "
            "sensor is alive and its resolution fine enough"
        )
    measured = 2.0 * np.log(curve.deviation)
    weight = np.sqrt(curve.degrees_of_freedom / (2.0 * _POINTS_ALIKE))
    terms = _terms(curve.tau_s)
    # Each coefficient scaled so that 1 explains the curve at the point where it counts most.
    scale = np.min(curve.deviation[:, None] ** 2 / terms, axis=0)

    def misfit(squares: Float64Array) -> Float64Array:
        """Return the differences of the log variances, in their standard deviations."""
        return np.asarray((np.log(terms @ (scale * squares)) - measured) * weight)

    best = least_squares(misfit, np.full(4, 0.5), bounds=(1e-12, np.inf), x_scale="jac")
    covariance = np.linalg.pinv(best.jac.T @ best.jac)
    squares = best.x * scale
    sigma = np.sqrt(np.diag(covariance)) * scale
    freedom = max(len(measured) / _POINTS_ALIKE - 4.0, 1.0)
    q, n, b, k = (_root(float(v), float(s)) for v, s in zip(squares, sigma, strict=True))
    return AllanFit(q, n, b, k, float(2.0 * best.cost / freedom))


def _terms(tau_s: Float64Array) -> Float64Array:
    """Return (n, 4): the factors of Q^2, N^2, B^2 and K^2."""
    flat = np.full_like(tau_s, _FLICKER)
    return np.stack([3.0 / tau_s**2, 1.0 / tau_s, flat, tau_s / 3.0], axis=1)


def _root(square: float, sigma_of_square: float) -> Coefficient:
    """Return the root of a square with its sigma, which near 0 is that of sqrt(0 + sigma)."""
    value = math.sqrt(square)
    return Coefficient(value, min(sigma_of_square / (2.0 * value), math.sqrt(sigma_of_square)))


def averaging_times_s(samples: int, rate_hz: float) -> Float64Array:
    """Return averaging times, eight a decade, up to a fifth of the duration."""
    decades = math.log10(samples / 5.0)
    steps = np.logspace(0.0, decades, int(decades * _POINTS_PER_DECADE) + 1)
    return np.unique(np.floor(steps + 1e-9)) / rate_hz


def _degrees_of_freedom(samples: int, averages: Float64Array) -> Float64Array:
    """Return those of the overlapping Allan variance, the fewer of white and random-walk noise.

    Riley, Handbook of Frequency Stability Analysis (NIST SP 1065), section 5.4, with N phase
    points = samples + 1.
    """
    n, m = samples + 1.0, averages
    white = (3.0 * (n - 1.0) / (2.0 * m) - 2.0 * (n - 2.0) / n) * 4.0 * m**2 / (4.0 * m**2 + 5.0)
    walk = (n - 2.0) / m * ((n - 1.0) ** 2 - 3.0 * m * (n - 1.0) + 4.0 * m**2) / (n - 3.0) ** 2
    return np.maximum(np.minimum(white, walk), 1.0)


def require_signal(values: Float64Array, rate_hz: float) -> None:
    """Refuse what is no signal.

    Raises:
        RigError: not one dimension of three or more numbers, or a rate that is none.
    """
    if values.ndim != 1 or len(values) < 3 or not np.isfinite(values).all():
        raise RigError(
            f"a signal of shape {values.shape} with {np.count_nonzero(~np.isfinite(values))} "
            "values that are no numbers; expected one dimension of finite samples"
        )
    if not 0.0 < rate_hz < math.inf:
        raise RigError(f"rate_hz is {rate_hz}; expected a number above 0")
