"""Without wheels: which share of a forward force is acceleration, and which is a slope.

An accelerometer cannot tell the two apart. What it can see is the roll: ground that rolls the
rover pitches it as much. With sigma_a of the rover's acceleration and sigma_t of the ground's
pitch, the best guess of the acceleration is the share

    alpha = sigma_a^2 / (sigma_a^2 + g^2 sigma_t^2)

of the force beyond that of the last rest, and its variance is sigma_a^2 (1 - alpha).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapping.ego_motion.settings import EgoMotionSettings
from mapping.ego_motion.standstill import BoolArray
from mapping.geometry import Float64Array

_ROUGHNESS_TIME_S = 3.0


@dataclass(frozen=True, slots=True)
class GroundGuess:
    """The guess at N ticks.

    Attributes:
        share: alpha.
        pitch_at_rest_rad: levelled pitch of the last rest, to which the share belongs.
        pitch_variance_rad2: what the guess adds to the variance of the pitch.
        walk_m2_s3: what it adds to the variance of the speed per second.
    """

    share: Float64Array
    pitch_at_rest_rad: Float64Array
    pitch_variance_rad2: Float64Array
    walk_m2_s3: Float64Array


class GroundWatch:
    """Follows how rough the ground is, tick by tick in order of time."""

    def __init__(self, settings: EgoMotionSettings) -> None:
        self._settings = settings
        self._roll_mean = self._roll_variance = 0.0
        self._pitch_at_rest = np.nan

    def add(
        self,
        roll_rad: Float64Array,
        roll_sigma_rad: Float64Array,
        pitch_rad: Float64Array,
        still: BoolArray,
    ) -> GroundGuess:
        """Take the levelled tilt of the next ticks; NaN where there is none."""
        s = self._settings
        rough, rest = np.zeros(len(still)), np.zeros(len(still))
        for i in range(len(still)):
            self._follow(float(roll_rad[i]), float(roll_sigma_rad[i]))
            if (still[i] or np.isnan(self._pitch_at_rest)) and np.isfinite(pitch_rad[i]):
                self._pitch_at_rest = float(pitch_rad[i])
            rough[i], rest[i] = self._roll_variance, self._pitch_at_rest
        own = s.acceleration_m_s2**2
        tilt = rough + s.ground_tilt_rad**2
        share = np.where(np.isfinite(rest), own / (own + s.gravity_m_s2**2 * tilt), 0.0)
        return GroundGuess(
            share=share,
            pitch_at_rest_rad=np.nan_to_num(rest),
            pitch_variance_rad2=share * tilt,
            walk_m2_s3=2.0 * s.ground_tilt_time_s * own * (1.0 - share),
        )

    def _follow(self, roll: float, sigma: float) -> None:
        """Follow mean and variance of the roll, without what its own error adds."""
        if not np.isfinite(roll):
            return
        gain = self._settings.tick_s / _ROUGHNESS_TIME_S
        away = roll - self._roll_mean
        self._roll_mean += gain * away
        fresh = max(away * away - sigma * sigma, 0.0)
        self._roll_variance += gain * (fresh - self._roll_variance)
