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

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import ndtr
from scipy.stats import t

Float64Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Below this the steps hide the noise: it is bounded, not told.
BELOW_STEPS = 0.3
PHASES = 32
# Share of readings that the model does not explain, such as flying pixels.
_OUTLIERS = 1e-5
_SMALLEST_STEPS = 0.02
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
        low, high: 95 % confidence interval, steps; 0 to BELOW_STEPS when `is_below`.
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
    total = table.counts.sum(axis=0)
    smallest = max(_SMALLEST_STEPS, table.rounding_steps)
    start, bounds = _start(table, total, smallest)
    args = (total, table.phases, table.edges)
    starts = [
        np.array([start[0], start[1], behind])
        for behind in (np.log(max(smallest, 0.5 * np.exp(start[1]))), np.log(1.05 * smallest))
    ]
    best = minimize(
        _loss,
        min(starts, key=lambda parameters: _loss(parameters, *args)),
        args=args,
        method="L-BFGS-B",
        bounds=bounds,
        options={"ftol": 1e-11, "gtol": 1e-7},
    )
    return _described(table, total, np.asarray(best.x, np.float64), smallest)


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


def expected_shares(
    parameters: Float64Array, phases: Float64Array, edges: Float64Array
) -> Float64Array:
    """Return (PHASES, bins): the probability of each offset at each phase.

    Args:
        parameters: offset, log s1, log s2.
        phases: (PHASES,) place of the plane between two steps, 0 to 1.
        edges: (bins + 1,) of the offsets, steps.
    """
    offset, before, behind = parameters[0], np.exp(parameters[1]), np.exp(parameters[2])
    phase = phases[:, np.newaxis]
    reach = int(np.ceil(4.5 * before + abs(offset))) + 1
    steps = np.arange(-reach, reach + 2.0)
    share = np.diff(ndtr((np.append(steps, steps[-1] + 1.0) - 0.5 - phase - offset) / before))
    smeared = ndtr((edges + phase[..., np.newaxis] - steps[:, np.newaxis]) / behind)
    found = np.diff(np.einsum("jk,jke->je", share, smeared), axis=1)
    shares: Float64Array = (1.0 - _OUTLIERS) * found + _OUTLIERS / (edges.size - 1)
    return shares


def _loss(
    parameters: Float64Array, total: IntArray, phases: Float64Array, edges: Float64Array
) -> float:
    """Return the negative log likelihood per reading."""
    shares = expected_shares(parameters, phases, edges)
    return -float(np.sum(total * np.log(shares))) / float(total.sum())


def _described(
    table: ReadingTable, total: IntArray, best: Float64Array, smallest: float
) -> QuantisedSpread:
    before, behind = float(np.exp(best[1])), float(np.exp(best[2]))
    sigma = float(np.sqrt(before**2 + behind**2 - smallest**2))
    covariance, naive = _covariances(table, total, best, smallest)
    slope = np.array([0.0, before**2, behind**2]) / sigma**2  # of log sigma
    # Few patches tell their own spread badly; independent readings are the best that can be.
    variance = max(float(slope @ covariance @ slope), float(slope @ naive @ slope))
    error = float(np.sqrt(variance))
    factor = float(np.exp(min(t.ppf(0.975, len(table.counts) - 1) * error, _WIDEST_LOG)))
    is_below = sigma < BELOW_STEPS
    readings = int(total.sum())
    hidden = _phase_concentration(table, total) / np.sqrt(12.0) if is_below else 0.0
    return QuantisedSpread(
        sigma=BELOW_STEPS if is_below else sigma,
        low=0.0 if is_below else sigma / factor,
        high=BELOW_STEPS if is_below else sigma * factor,
        is_below=is_below,
        offset=float(best[0]),
        offset_sigma=float(
            min(np.hypot(np.sqrt(max(float(covariance[0, 0]), 0.0)), hidden), 1.0 / np.sqrt(12.0))
        ),
        before=before,
        behind=behind,
        readings=readings,
        effective=readings * float(slope @ naive @ slope) / max(variance, 1e-18),
    )


def _phase_concentration(table: ReadingTable, total: IntArray) -> float:
    """Return 1 when all readings have one phase, so that steps hide the place; 0 when uniform."""
    turns = np.exp(2j * np.pi * table.phases)
    return float(np.abs(np.average(turns, weights=total.sum(axis=1))))


def _covariances(
    table: ReadingTable, total: IntArray, best: Float64Array, smallest: float
) -> tuple[Float64Array, Float64Array]:
    """Return the sandwich of the parameters and what it would be for independent readings."""
    step = 1e-4
    free = [0, 1, 2] if best[2] > np.log(smallest) + 0.01 else [0, 1]
    slopes = np.stack(
        [
            (
                np.log(expected_shares(best + step * axis, table.phases, table.edges))
                - np.log(expected_shares(best - step * axis, table.phases, table.edges))
            )
            / (2.0 * step)
            for axis in np.eye(3)[free]
        ]
    )
    weight = total.sum(axis=1)[:, np.newaxis] * expected_shares(best, table.phases, table.edges)
    information = np.einsum("pjy,qjy,jy->pq", slopes, slopes, weight)
    bread = np.linalg.pinv(information, rcond=1e-12)
    scores = np.einsum("pjy,bjy->bp", slopes, table.counts)
    patches = len(scores)
    meat = (scores - scores.mean(axis=0)).T @ (scores - scores.mean(axis=0))
    sandwich, naive = np.zeros((2, 3, 3))
    sandwich[np.ix_(free, free)] = bread @ meat @ bread * patches / max(patches - 1, 1)
    naive[np.ix_(free, free)] = bread
    return sandwich, naive


def sheppard(spread: float, step: float) -> float:
    """Return the spread without that of steps with uniform phase: sqrt(s^2 - q^2 / 12), or 0."""
    return float(np.sqrt(max(spread**2 - step**2 / 12.0, 0.0)))
