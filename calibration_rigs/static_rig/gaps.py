"""Where a sensor was silent: how long, how that is told, and how it is kept out of a result."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Float64Array = NDArray[np.float64]

# A pause this many times the usual step is a gap, unless it is so short that what moves below 3 Hz
# is drawn through it all the same.
_GAP_STEPS, _GAP_LEAST_S = 3.0, 0.1


class Gap(NamedTuple):
    """A silence: the times of the last sample before it and of the first one behind it."""

    begin_s: float
    end_s: float

    @property
    def length_s(self) -> float:
        """How long it is."""
        return self.end_s - self.begin_s


def gaps_of(t_s: Float64Array) -> tuple[Gap, ...]:
    """Return the gaps between times (n,), increasing."""
    steps_s = np.diff(t_s)
    if not steps_s.size:
        return ()
    limit_s = max(_GAP_STEPS * float(np.median(steps_s)), _GAP_LEAST_S)
    return tuple(Gap(float(t_s[i]), float(t_s[i + 1])) for i in np.flatnonzero(steps_s > limit_s))


def away_from(grid: Float64Array, gaps: Sequence[Gap], margin_s: float) -> Float64Array:
    """Return the times of a grid (n,) that are not within `margin_s` of a gap."""
    keep = np.ones(grid.size, np.bool_)
    for gap in gaps:
        keep &= (grid <= gap.begin_s - margin_s) | (grid >= gap.end_s + margin_s)
    return grid[keep]


def bridged(t_s: Float64Array, values: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return times and values with a straight line of samples through each gap.

    A spline without it swings out in a gap, by more the noisier its rims are, and beyond them too.
    """
    gaps = gaps_of(t_s)
    if not gaps:
        return t_s, values
    step_s = float(np.median(np.diff(t_s)))
    lines = [np.arange(gap.begin_s + step_s, gap.end_s - 0.5 * step_s, step_s) for gap in gaps]
    everywhere = np.sort(np.concatenate([t_s, *lines]))
    return everywhere, np.interp(everywhere, t_s, values)


def describe_gaps(gaps: Sequence[Gap]) -> str:
    """Return how many, how long and where, for a line."""
    longest = max(gaps, key=lambda gap: gap.length_s)
    where = f"{longest.length_s:.2f} s, {longest.begin_s:.2f} s after the first"
    if len(gaps) == 1:
        return f"no samples for {where}"
    total_s = sum(gap.length_s for gap in gaps)
    return f"no samples in {len(gaps)} gaps, {total_s:.2f} s together, the longest of {where}"
