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
from calibration_rigs.static_rig.gaps import describe_gaps, gaps_of
from drivers.samples import WheelTwistSample, YawRateSample

Float64Array = NDArray[np.float64]

_STILL_M_S = 0.01
_REST_S = 1.0
# A gyro that nobody calibrated is off by a few per cent, and its bias is that of the rests.
_GYRO_SHARE, _GYRO_LEAST_RAD = 0.15, math.radians(5.0)
_GYRO_MARGIN_S = _REST_S / 3.0
# Wheels that drag sideways make a rover 1.4 to 1.5 times as wide as it is (`skid_steer`). What is
# outside these bounds, in geometric widths, no ground does.
_USUAL_RATIO = 1.5
_NARROWEST, _WIDEST = 0.5, 3.0


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
    samples: Sequence[WheelTwistSample],
    true_rad: Sequence[float],
    *,
    gyro: Sequence[YawRateSample] = (),
) -> EffectiveTrack:
    """Return the effective track from a recording of turns with a second of rest around each.

    Args:
        samples: of the wheels.
        true_rad: the turns' angles, counter-clockwise positive.
        gyro: of the same recording, to confirm the angles; empty = nothing confirms them.

    Raises:
        RigError: the wheels' sides are not told apart, other turns than angles, speeds missing
            within a turn, wrong sense, the gyro saw other angles, or a track far from the one in
            use.
    """
    known = [s for s in samples if s.left_m_s is not None and s.right_m_s is not None]
    t_s, difference = _difference(known)
    turns = _moves(t_s, difference)
    if len(turns) != len(true_rad) or not turns:
        gaps = gaps_of(t_s)
        raise RigError(
            f"{len(turns)} turns with rest around them and {len(true_rad)} known angles; expected "
            "as many of one as of the other"
            + (f"; the wheels have {describe_gaps(gaps)}" if gaps else "")
        )
    _require_whole([t_s[part] for part in turns])
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
    spans_s = [(float(t_s[part][0]), float(t_s[part][-1])) for part in turns]
    _confirm_angles(spans_s, true_rad, gyro, known[0].t_ns)
    _check_width(tracks, _track_in_use_m(known, difference))
    n = len(tracks)
    sigma = float(np.std(tracks, ddof=1) / math.sqrt(n)) if n > 1 else math.inf
    return EffectiveTrack(Coefficient(float(tracks.mean()), sigma), (*map(float, tracks),))


def _require_whole(turns_s: Sequence[Float64Array]) -> None:
    """Refuse turns with a gap, over which nobody knows how far the wheels went."""
    for number, t_s in enumerate(turns_s, start=1):
        gaps = gaps_of(t_s)
        if gaps:
            longest_s = max(gap.length_s for gap in gaps)
            raise RigError(
                f"turn {number} has no wheel speeds for {longest_s:.2f} s; expected a recording "
                "without gaps in its turns: record it again"
            )


def _confirm_angles(
    spans_s: Sequence[tuple[float, float]],
    true_rad: Sequence[float],
    gyro: Sequence[YawRateSample],
    began_ns: int,
) -> None:
    """Refuse angles that the gyro did not see; which way its axis points does not matter.

    Args:
        spans_s: begin and end of each turn after `began_ns`.
        true_rad: the stated angles.
        gyro: of the same recording.
        began_ns: from which the spans count.
    """
    t_s = np.array([(sample.t_ns - began_ns) * 1e-9 for sample in gyro])
    rate = np.array([sample.rate_rad_s for sample in gyro])
    parts = [(t_s > a - _GYRO_MARGIN_S) & (t_s < b + _GYRO_MARGIN_S) for a, b in spans_s]
    resting = ~np.any(parts, axis=0)
    bias = float(rate[resting].mean()) if resting.any() else 0.0
    for number, (part, (begin_s, end_s), stated) in enumerate(
        zip(parts, spans_s, true_rad, strict=True), start=1
    ):
        if not part.any() or t_s[part][0] > begin_s or t_s[part][-1] < end_s:
            continue  # the gyro was not there for the whole turn
        seen = abs(_integral(t_s[part], rate[part] - bias))
        limit = max(_GYRO_SHARE * abs(stated), _GYRO_LEAST_RAD)
        if abs(seen - abs(stated)) > limit:
            raise RigError(
                f"turn {number} is stated as {math.degrees(stated):g} degrees and the gyro saw "
                f"{math.degrees(seen):.1f}; expected a difference up to {math.degrees(limit):.0f}: "
                "record turns on the spot with rests around them, and give their angles in order"
            )


def _check_width(tracks: Float64Array, in_use_m: float | None) -> None:
    """Refuse tracks that cannot be the rover's, whose wheels' yaw rates were made with another."""
    if in_use_m is None:
        return
    geometric_m = in_use_m / _USUAL_RATIO
    low_m, high_m = _NARROWEST * geometric_m, _WIDEST * geometric_m
    if not (low_m <= tracks.min() and tracks.max() <= high_m):
        raise RigError(
            f"tracks of {tracks.round(3).tolist()} m, {in_use_m:.3f} m in use; expected "
            f"{low_m:.2f} to {high_m:.2f} m: check the angles, and that the recording holds turns "
            "on the spot"
        )


def _track_in_use_m(samples: Sequence[WheelTwistSample], difference: Float64Array) -> float | None:
    """Return the effective track of the recorded yaw rates; None when these tell nothing."""
    yaw_rad_s = sum(abs(sample.yaw_rate_rad_s) for sample in samples)
    return float(np.abs(difference).sum() / yaw_rad_s) if yaw_rad_s > 0.0 else None


def _difference(known: Sequence[WheelTwistSample]) -> tuple[Float64Array, Float64Array]:
    """Return time (s) and right less left rim speed (m/s)."""
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
