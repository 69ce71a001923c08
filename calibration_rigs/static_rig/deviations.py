"""All the usual deviations of a signal at rest, for those who compare with other tools.

The coefficients N, B and K are fitted to the overlapping Allan deviation alone: it uses every
sample, and its degrees of freedom are known. The others tell noises apart that it does not:
the modified one white from flicker noise of phase, Hadamard's is blind to a steady drift.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import allantools
import numpy as np
from numpy.typing import NDArray

from calibration_rigs.errors import RigError
from calibration_rigs.static_rig.allan import averaging_times_s, require_signal

Float64Array = NDArray[np.float64]

# The first line of the table.
COLUMNS = "signal,deviation,tau_s,value"
_FUNCTIONS = {
    "adev": allantools.adev,
    "oadev": allantools.oadev,
    "mdev": allantools.mdev,
    "hdev": allantools.hdev,
    "tdev": allantools.tdev,
}
KINDS = tuple(_FUNCTIONS)


class AtRest(NamedTuple):
    """A signal (n,) of a sensor at rest, without gaps, and its rate."""

    values: Float64Array
    rate_hz: float


def deviation(
    kind: str, signal: AtRest, tau_s: Float64Array | None = None
) -> tuple[Float64Array, Float64Array]:
    """Return averaging times and deviations, in the unit of the signal; tdev in that times s.

    Args:
        kind: adev, oadev (overlapping), mdev (modified), hdev (Hadamard), tdev (time): Riley,
            NIST SP 1065, section 5.2.
        signal: rates, that is frequencies in the terms of that handbook.
        tau_s: averaging times, else eight a decade; those that the signal is too short for are
            left out.

    Raises:
        RigError: too few samples, or one that is not a number.
    """
    require_signal(signal.values, signal.rate_hz)
    wished = averaging_times_s(len(signal.values), signal.rate_hz) if tau_s is None else tau_s
    tau, found, _, _ = _FUNCTIONS[kind](
        signal.values, rate=signal.rate_hz, data_type="freq", taus=wished
    )
    return np.asarray(tau, np.float64), np.asarray(found, np.float64)


def deviations_csv(signals: Mapping[str, AtRest]) -> str:
    """Return a table of every deviation of every signal, one value a line.

    Raises:
        RigError: there is no signal, or one is too short.
    """
    if not signals:
        raise RigError("no signal to take deviations of; give a recording at rest (--rest)")
    lines = [COLUMNS]
    for name, signal in signals.items():
        for kind in KINDS:
            pairs = zip(*deviation(kind, signal), strict=True)
            lines += [f"{name},{kind},{tau:.9g},{value:.9g}" for tau, value in pairs]
    return "\n".join(lines) + "\n"
