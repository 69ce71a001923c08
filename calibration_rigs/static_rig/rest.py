"""When a sensor lay still: the stretches of a recording in which nothing moves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Float64Array = NDArray[np.float64]


class Stretch(NamedTuple):
    """Samples first..end-1 of a signal."""

    first: int
    end: int


def rest_stretches(
    t_s: Float64Array,
    values: Float64Array,
    *,
    threshold: float,
    window_s: float = 1.0,
    shortest_s: float = 2.0,
) -> list[Stretch]:
    """Return the stretches in which a signal (n, axes) stays quiet.

    A sample is quiet when the spread (root of the variances' sum over the axes) of the window
    around it is `threshold` at most, in the unit of the signal. Half a window at either end of a
    stretch is dropped: it may hold the end of a motion that is still below the threshold.
    """
    half = max(round(window_s / _step_s(t_s) / 2.0), 1)
    quiet = _spread(values, half) <= threshold
    edges = np.flatnonzero(np.diff(np.concatenate([[False], quiet, [False]]).astype(np.int8)))
    stretches = [Stretch(int(a) + half, int(b) - half) for a, b in edges.reshape(-1, 2)]
    return [s for s in stretches if s.end > s.first and t_s[s.end - 1] - t_s[s.first] >= shortest_s]


def quiet_spread(t_s: Float64Array, values: Float64Array, window_s: float = 1.0) -> float:
    """Return the spread of a sensor (n, axes) at rest, from a recording that is mostly anything.

    It is the spread that one window in twenty stays below: at rest all windows spread alike, so a
    twentieth of rest is enough.
    """
    half = max(round(window_s / _step_s(t_s) / 2.0), 1)
    return float(np.percentile(_spread(values, half), 5.0))


def _step_s(t_s: Float64Array) -> float:
    return float(np.median(np.diff(t_s)))


def _spread(values: Float64Array, half: int) -> Float64Array:
    """Return the spread of the samples i - half .. i + half around each sample i."""
    centred = values - values.mean(axis=0)
    sums = np.cumsum(np.vstack([np.zeros((1, values.shape[1])), centred]), axis=0)
    squares = np.cumsum(np.vstack([np.zeros((1, values.shape[1])), centred**2]), axis=0)
    index = np.arange(len(values))
    low, high = np.maximum(index - half, 0), np.minimum(index + half + 1, len(values))
    count = (high - low)[:, None]
    mean = (sums[high] - sums[low]) / count
    variance = (squares[high] - squares[low]) / count - mean**2
    return np.asarray(np.sqrt(np.maximum(variance, 0.0).sum(axis=1)))
