"""Whether readings are those of a normal law that was rounded: chi-square over the steps.

Tests for the plain normal law (Shapiro-Wilk, Anderson-Darling, Kolmogorov-Smirnov) reject rounded
readings always; the probabilities of whole steps, Phi((k + 1/2) q) - Phi((k - 1/2) q), are what to
compare with.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr
from scipy.stats import chi2

from calibration_rigs.plate_rig.quantised import QuantisedSpread

Float64Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Goodness:
    """Chi-square over the steps: `p` below 0.05 says that the readings are not quantised-normal."""

    statistic: float
    degrees: int
    p: float
    readings: int


def goodness_of_fit(
    spread: QuantisedSpread, predicted: Float64Array, readings: Float64Array
) -> Goodness | None:
    """Return how well a normal law that was rounded explains a few readings.

    The parameters come from all readings, so none is lost to the fit. Steps are pooled until at
    least 5 readings are expected in each; None when fewer than three are left.

    Args:
        spread: fitted to all readings.
        predicted: (n,) disparity of the plane at readings far enough apart, steps.
        readings: (n,) what was read there, steps; NaN = none.
    """
    there = np.isfinite(readings)
    true = predicted[there] + spread.offset
    nearest = np.rint(true)
    code = np.rint(readings[there]) - nearest
    reach = int(np.ceil(5.0 * np.hypot(spread.before, spread.behind))) + 2
    steps = np.arange(-reach, reach + 1.0)
    shares = _code_shares(true - nearest, steps, spread).sum(axis=0)
    found = np.array([np.count_nonzero(code == step) for step in steps], np.float64)
    expected, observed = _pooled(shares, found)
    if expected.size < 3:
        return None
    statistic = float(np.sum((observed - expected) ** 2 / expected))
    degrees = expected.size - 1
    return Goodness(statistic, degrees, float(chi2.sf(statistic, degrees)), int(code.size))


def _code_shares(phase: Float64Array, steps: Float64Array, spread: QuantisedSpread) -> Float64Array:
    """Return (n, steps): the probability to read nearest to each step, for each phase."""
    edges = np.append(steps, steps[-1] + 1.0) - 0.5
    before = np.diff(ndtr((edges - phase[:, np.newaxis]) / spread.before))
    behind = np.diff(ndtr((edges[np.newaxis] - steps[:, np.newaxis]) / spread.behind), axis=1)
    shares: Float64Array = before @ behind
    return shares


def _pooled(expected: Float64Array, observed: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Pool neighbours from both ends until 5 are expected in each bin."""
    bins: list[list[float]] = []
    for e, o in zip(expected, observed, strict=True):
        if bins and bins[-1][0] < 5.0:
            bins[-1][0] += e
            bins[-1][1] += o
        else:
            bins.append([e, o])
    if len(bins) > 1 and bins[-1][0] < 5.0:
        last = bins.pop()
        bins[-1][0] += last[0]
        bins[-1][1] += last[1]
    pairs = np.array(bins)
    return pairs[:, 0], pairs[:, 1]
