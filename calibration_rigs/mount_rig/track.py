"""The effective track of a skid-steered rover from turns on the spot by known angles.

omega = (v_right - v_left) / B_e, hence B_e = integral of (v_right - v_left) over the angle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration_rigs.errors import RigError
from calibration_rigs.static_rig.allan import Coefficient
from drivers.samples import WheelTwistSample

Float64Array = NDArray[np.float64]

_STILL_M_S = 0.01
_REST_S = 1.0


@dataclass(frozen=True, slots=True)
class EffectiveTrack:
    """What the wheels' difference over the angle says.

    Attributes:
        track_m: effective track and its sigma, from the scatter of the turns; infinite for one.
        per_turn_m: of each turn.
    """

    track_m: Coefficient
    per_turn_m: tuple[float, ...]

    def as_json(self) -> object:
        """Return all numbers by name; an infinite sigma as None."""
        sigma = self.track_m.sigma
        return {
            "effective_track_m": self.track_m.value,
            "sigma_m": sigma if math.isfinite(sigma) else None,
            "per_turn_m": list(self.per_turn_m),
        }

    def describe(self) -> list[str]:
        """Return lines for people."""
        sigma = self.track_m.sigma
        known = f"+- {sigma:.4f} m" if math.isfinite(sigma) else "(one turn: no sigma)"
        turns = ", ".join(f"{value:.4f}" for value in self.per_turn_m)
        return [f"effective track {self.track_m.value:.4f} {known}; turns: {turns} m"]


def calibrate_track(
    samples: Sequence[WheelTwistSample], true_rad: Sequence[float]
) -> EffectiveTrack:
    """Return the effective track from a recording of turns with a second of rest around each.

    Raises:
        RigError: the wheels' sides are not told apart, other turns than angles, wrong sense.
    """
    t_s, difference = _difference(samples)
    turns = _moves(t_s, difference)
    if len(turns) != len(true_rad) or not turns:
        raise RigError(
            f"{len(turns)} turns with rest around them and {len(true_rad)} known angles; expected "
            "as many of one as of the other"
        )
    tracks = np.array(
        [
            _integral(t_s[part], difference[part]) / angle if angle else math.nan
            for part, angle in zip(turns, true_rad, strict=True)
        ]
    )
    if not np.all(tracks > 0.0):
        raise RigError(
            f"tracks of {tracks.round(3).tolist()} m; expected numbers above 0: check the order "
            "and the signs of the angles, counter-clockwise is positive"
        )
    n = len(tracks)
    sigma = float(np.std(tracks, ddof=1) / math.sqrt(n)) if n > 1 else math.inf
    return EffectiveTrack(Coefficient(float(tracks.mean()), sigma), (*map(float, tracks),))


def _difference(samples: Sequence[WheelTwistSample]) -> tuple[Float64Array, Float64Array]:
    """Return time (s) and right less left rim speed (m/s)."""
    known = [s for s in samples if s.left_m_s is not None and s.right_m_s is not None]
    if len(known) < 2:
        raise RigError(
            "the recording holds no speeds of left and right wheels; record /wheels/speeds"
        )
    t_s = np.array([(s.t_ns - known[0].t_ns) * 1e-9 for s in known])
    left = np.array([s.left_m_s for s in known], np.float64)
    right = np.array([s.right_m_s for s in known], np.float64)
    return t_s, right - left


def _moves(t_s: Float64Array, difference: Float64Array) -> list[slice]:
    """Return the stretches in which the wheels turn, parted by a second of rest or more."""
    moving = np.flatnonzero(np.abs(difference) > _STILL_M_S)
    if not moving.size:
        return []
    starts = np.concatenate([[True], np.diff(t_s[moving]) > _REST_S])
    groups = np.split(moving, np.flatnonzero(starts)[1:])
    return [slice(max(int(g[0]) - 1, 0), int(g[-1]) + 2) for g in groups]


def _integral(t_s: Float64Array, values: Float64Array) -> float:
    return float(np.sum(np.diff(t_s) * (values[1:] + values[:-1]) / 2.0))
