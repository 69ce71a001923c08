"""The spread of readings that come in steps, told apart from the steps themselves.

A disparity sensor rounds to a step before it speaks: a reading is

    x = round(mu + n1) + n2,   n1 ~ N(0, s1^2),   n2 ~ N(0, s2^2)

in steps of disparity, where mu is the true plane and n2 is what is added behind the rounding
(smoothing, conversion to millimetres). The standard deviation of x says little about s1 while
s1 < 1: at s1 = 0.1 most pixels never change. What does say it is how often each step occurs at
each *phase*, the place of mu between two steps. Readings are therefore counted in a table of
phase and offset, and (mu's offset, s1, s2) maximise its likelihood: the interval-censored maximum
likelihood, with s2 = 0 a pure one. The uncertainty is that of a sandwich (Huber 1967) whose
pieces are patches of the plate, so neighbours that share noise, and pixels that keep theirs from
frame to frame, widen it.

Sheppard's correction s^2 - 1/12 is the same estimate when the phases are uniform.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import t

from calibration_rigs.plate_rig.step_law import shares_and_slopes

Float64Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Below this the steps hide the noise: it is bounded, not told.
BELOW_STEPS = 0.3
# Readings of one bin count as of one phase; with half as many sigma is 0.03 % too small.
PHASES = 64
_SMALLEST_STEPS = 0.008
# What the law leaves out, the shape of rounding to millimetres and the curvature of 1/Z within a
# step, moves sigma by up to 0.1 %; as a standard deviation (rectangular, GUM 4.3.7).
_LAW_LOG = 1e-3 / np.sqrt(3.0)
# Log of how far an interval may reach when the readings hardly tell.
_WIDEST_LOG = 3.0


@dataclass(frozen=True, slots=True)
class ReadingTable:
    """Readings counted by patch, phase and offset from the predicted plane.

    Attributes:
        counts: (patches, PHASES, bins) readings.
        phases: (PHASES,) mean place of the plane between two steps, 0 to 1.
        edges: (bins + 1,) of the offsets, steps.
        rounding_steps: standard deviation of the rounding to millimetres, steps; it is part of
            s2 and no noise of the sensor.
    """

    counts: IntArray
    phases: Float64Array
    edges: Float64Array
    rounding_steps: float


@dataclass(frozen=True, slots=True)
class QuantisedSpread:
    """What the table says.

    Attributes:
        sigma: spread of the readings without that of the steps, steps; an upper bound of
            BELOW_STEPS when `is_below`.
        low, high: 95 % confidence interval, steps; low = 0 and high at least BELOW_STEPS when
            `is_below`.
        is_below: the spread is less than BELOW_STEPS.
        offset, offset_sigma: of the true plane from the predicted one, steps.
        before, behind: s1 and s2, steps.
        readings, effective: how many, and how many independent ones would tell as much.
    """

    sigma: float
    low: float
    high: float
    is_below: bool
    offset: float
    offset_sigma: float
    before: float
    behind: float
    readings: int
    effective: float


def count_readings(
    predicted: Float64Array,
    readings: Float64Array,
    patches: IntArray,
    rounding_steps: float,
) -> ReadingTable:
    """Count readings against the plane that they should lie on.

    Args:
        predicted: (pixels,) disparity of the plane, in steps.
        readings: (frames, pixels) disparity read, in steps; NaN = none.
        patches: (pixels,) number of the patch of each pixel, from 0.
        rounding_steps: see `ReadingTable`.
    """
    offset = readings - predicted
    spread = float(np.nanstd(offset))
    width = max(1.0 / 16.0, spread / 10.0)
    half = max(2.0, 6.0 * spread)
    bins = 2 * int(np.ceil(half / width))
    edges: Float64Array = np.arange(bins + 1, dtype=np.float64) * width - 0.5 * bins * width
    place = np.mod(predicted, 1.0)
    phase = np.minimum((place * PHASES).astype(np.int64), PHASES - 1)
    pixels = np.bincount(phase, minlength=PHASES)
    centres = (np.arange(PHASES) + 0.5) / PHASES
    mean = np.bincount(phase, place, PHASES) / np.maximum(pixels, 1)
    row = (patches * PHASES + phase) * bins
    column = np.floor((offset - edges[0]) / width)
    inside = (column >= 0) & (column < bins)  # false for NaN
    index = (row + np.where(inside, column, 0.0).astype(np.int64))[inside]
    size = int(patches.max()) + 1
    counts = np.bincount(index, minlength=size * PHASES * bins)
    phases: Float64Array = np.where(pixels > 0, mean, centres)
    return ReadingTable(counts.reshape(size, PHASES, bins), phases, edges, rounding_steps)


def fit_spread(table: ReadingTable) -> QuantisedSpread:
    """Return the spread of a table's readings and its uncertainty."""
    # A plate that faces the camera has few phases.
    some = table.counts.any(axis=(0, 2))
    seen = replace(table, counts=table.counts[:, some], phases=table.phases[some])
    total = seen.counts.sum(axis=0)
    smallest = max(_SMALLEST_STEPS, seen.rounding_steps)
    start, bounds = _start(seen, total, smallest)
    args = (total, seen.phases, seen.edges)
    starts = [
        np.array([start[0], start[1], behind])
        for behind in (np.log(max(smallest, 0.5 * np.exp(start[1]))), np.log(1.05 * smallest))
    ]
    best = minimize(
        _loss,
        min(starts, key=lambda parameters: _loss(parameters, *args)[0]),
        args=args,
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"ftol": 1e-11, "gtol": 1e-7},
    )
    return _described(seen, total, np.asarray(best.x, np.float64), smallest)


def _start(
    table: ReadingTable, total: IntArray, smallest: float
) -> tuple[tuple[float, float], list[tuple[float, float]]]:
    """Return where to begin, from moments, and the bounds of (offset, log s1, log s2)."""
    centres = 0.5 * (table.edges[1:] + table.edges[:-1])
    weights = total.sum(axis=0)
    mean = float(np.average(centres, weights=weights))
    variance = float(np.average((centres - mean) ** 2, weights=weights))
    spread = np.sqrt(max(variance - 1.0 / 12.0, 0.01))
    widest = np.log(2.0 * np.sqrt(variance) + 1.0)
    bounds = [(mean - 1.0, mean + 1.0), (np.log(_SMALLEST_STEPS), widest)]
    return (mean, float(np.log(spread))), [*bounds, (np.log(smallest), widest)]


def _loss(
    parameters: Float64Array, total: IntArray, phases: Float64Array, edges: Float64Array
) -> tuple[float, Float64Array]:
    """Return the negative log likelihood per reading and its gradient."""
    shares, slopes = shares_and_slopes(parameters, phases, edges)
    readings = float(total.sum())
    gradient: Float64Array = np.tensordot(slopes, total / shares, 2) / -readings
    return -float(np.sum(total * np.log(shares))) / readings, gradient


def _described(
    table: ReadingTable, total: IntArray, best: Float64Array, smallest: float
) -> QuantisedSpread:
    before, behind = float(np.exp(best[1])), float(np.exp(best[2]))
    rounding = min(table.rounding_steps, behind)
    sigma = float(np.sqrt(before**2 + behind**2 - rounding**2))
    votes = _votes(table, best, smallest)
    error = _uncertainty(votes, np.array([0.0, before**2, behind**2]) / sigma**2)  # of log sigma
    reach = error.quantile * np.hypot(error.sigma, _LAW_LOG)
    factor = float(np.exp(min(reach, _WIDEST_LOG)))
    is_below = sigma < BELOW_STEPS
    readings = int(total.sum())
    hidden = _phase_concentration(table, total) / np.sqrt(12.0) if is_below else 0.0
    offset = _uncertainty(votes, np.array([1.0, 0.0, 0.0])).sigma
    return QuantisedSpread(
        sigma=BELOW_STEPS if is_below else sigma,
        low=0.0 if is_below else sigma / factor,
        high=_bound(sigma * factor) if is_below else sigma * factor,
        is_below=is_below,
        offset=float(best[0]),
        offset_sigma=float(min(np.hypot(offset, hidden), 1.0 / np.sqrt(12.0))),
        before=before,
        behind=behind,
        readings=readings,
        effective=readings * min(error.alone_sigma**2 / max(error.sigma**2, 1e-18), 1.0),
    )


def _bound(high: float) -> float:
    """Return the upper end where sigma is only bounded: a little above it may look so too."""
    return high if BELOW_STEPS < high < 1.1 * BELOW_STEPS else BELOW_STEPS


def _phase_concentration(table: ReadingTable, total: IntArray) -> float:
    """Return 1 when all readings have one phase, so that steps hide the place; 0 when uniform."""
    turns = np.exp(2j * np.pi * table.phases)
    return float(np.abs(np.average(turns, weights=total.sum(axis=1))))


class _Votes(NamedTuple):
    """What each patch says of the parameters that are free.

    free: their numbers. scores: (patches, free) derivatives of the patch's log likelihood.
    information: (patches, free, free) their expected covariance if readings are independent.
    """

    free: list[int]
    scores: Float64Array
    information: Float64Array


class _Uncertainty(NamedTuple):
    """Standard deviation of a combination of parameters.

    sigma: from how differently the patches vote. alone_sigma: if readings were independent.
    quantile: half of the 95 % interval is so many sigma.
    """

    sigma: float
    alone_sigma: float
    quantile: float


def _votes(table: ReadingTable, best: Float64Array, smallest: float) -> _Votes:
    free = [0, 1, 2] if best[2] > np.log(smallest) + 0.01 else [0, 1]
    shares, slopes = shares_and_slopes(best, table.phases, table.edges)
    slopes = slopes[free] / shares
    per_phase = np.einsum("pjy,qjy,jy->jpq", slopes, slopes, shares)
    information = np.einsum("bj,jpq->bpq", table.counts.sum(axis=2), per_phase)
    return _Votes(free, np.tensordot(table.counts, slopes, ([1, 2], [1, 2])), information)


def _uncertainty(votes: _Votes, slope: Float64Array) -> _Uncertainty:
    """Return the uncertainty of slope . parameters.

    A patch with the share h of what is known pulls the fit towards itself, which makes its score
    smaller by 1 - h; and if the shares differ, the sum of the squared scores has 1 / sum h^2 - 1
    degrees of freedom (Bell and McCaffrey 2002). With alike patches both are the textbook's.
    """
    bread = np.linalg.pinv(votes.information.sum(axis=0), rcond=1e-12)
    weight = bread @ slope[votes.free]
    alone = np.einsum("p,bpq,q->b", weight, votes.information, weight)
    variance = float(alone.sum())
    if variance <= 0.0:  # no reading depends on it
        return _Uncertainty(inf, 0.0, 1.0)
    share = alone / variance
    spread = (votes.scores @ weight) ** 2 / np.maximum(1.0 - share, 0.1)
    degrees = max(1.0 / float(share @ share) - 1.0, 1.0)
    return _Uncertainty(
        float(np.sqrt(spread.sum())), float(np.sqrt(variance)), float(t.ppf(0.975, degrees))
    )


def sheppard(spread: float, step: float) -> float:
    """Return the spread without that of steps with uniform phase: sqrt(s^2 - q^2 / 12), or 0."""
    return float(np.sqrt(max(spread**2 - step**2 / 12.0, 0.0)))
