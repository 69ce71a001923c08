"""How probable each offset from the plane is when readings come in steps.

A reading is x = round(mu + n1) + n2 with n1 ~ N(0, s1^2), n2 ~ N(0, s2^2), in steps; see
`quantised`. The step k is read with probability Phi((k + 1/2 - mu) / s1) - Phi((k - 1/2 - mu) / s1)
and then smeared by s2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

Float64Array = NDArray[np.float64]

# Share of readings that the law does not explain, such as flying pixels.
_OUTLIERS = 1e-5
_DENSITY = 1.0 / np.sqrt(2.0 * np.pi)


class _Parts(NamedTuple):
    """Where the two normal laws are asked, and what they say.

    before: (phases, steps + 1) bounds of the steps over s1. share: (phases, steps). behind:
    (phases, steps, bins + 1) edges over s2. smeared: (phases, steps, bins).
    """

    before: Float64Array
    share: Float64Array
    behind: Float64Array
    smeared: Float64Array


def _parts(parameters: Float64Array, phases: Float64Array, edges: Float64Array) -> _Parts:
    offset, s1, s2 = parameters[0], np.exp(parameters[1]), np.exp(parameters[2])
    phase = phases[:, np.newaxis]
    reach = int(np.ceil(4.5 * s1 + abs(offset))) + 1
    steps = np.arange(-reach, reach + 2.0)
    before = (np.append(steps, steps[-1] + 1.0) - 0.5 - phase - offset) / s1
    behind = (edges + phase[..., np.newaxis] - steps[:, np.newaxis]) / s2
    return _Parts(before, np.diff(ndtr(before)), behind, np.diff(ndtr(behind)))


def _all(found: Float64Array) -> Float64Array:
    """Return the probabilities with those of readings that are anywhere."""
    shares: Float64Array = (1.0 - _OUTLIERS) * found + _OUTLIERS / found.shape[1]
    return shares


def expected_shares(
    parameters: Float64Array, phases: Float64Array, edges: Float64Array
) -> Float64Array:
    """Return (phases, bins): the probability of each offset at each phase.

    Args:
        parameters: offset of the plane, log s1, log s2.
        phases: (phases,) place of the plane between two steps, 0 to 1.
        edges: (bins + 1,) of the offsets, steps.
    """
    parts = _parts(parameters, phases, edges)
    return _all(np.einsum("jk,jke->je", parts.share, parts.smeared))


def shares_and_slopes(
    parameters: Float64Array, phases: Float64Array, edges: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Return `expected_shares` and (3, phases, bins): its derivatives by the parameters."""
    parts = _parts(parameters, phases, edges)
    density = _DENSITY * np.exp(-0.5 * parts.before**2)
    by_offset = -np.diff(density) / np.exp(parameters[1])
    by_before = -np.diff(parts.before * density)
    by_behind = -np.diff(parts.behind * (_DENSITY * np.exp(-0.5 * parts.behind**2)))
    moved = np.stack([parts.share, by_offset, by_before])
    found, *slopes = np.einsum("pjk,jke->pje", moved, parts.smeared, optimize=True)
    slopes.append(np.einsum("jk,jke->je", parts.share, by_behind))
    return _all(found), (1.0 - _OUTLIERS) * np.stack(slopes)
