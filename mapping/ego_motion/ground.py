"""Without wheels: which share of a forward force is acceleration, and which is a slope.

An accelerometer cannot tell the two apart. What it can see is the roll: ground that rolls the
rover pitches it as much. With sigma_a of the rover's acceleration and sigma_t of the ground's
pitch, the best guess of the acceleration is the share

    alpha = sigma_a^2 / (sigma_a^2 + g^2 sigma_t^2)

of the force beyond the mean force of the last rest, and its variance is sigma_a^2 (1 - alpha).

A slope that goes on the roll need not show; but no rover accelerates for long. Of a pitch that
keeps away from that of the last rest for seconds, what is beyond the speeds to be expected is
ground.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from mapping.ego_motion.settings import EgoMotionSettings
from mapping.ego_motion.standstill import BoolArray
from mapping.geometry import Float64Array

_ROUGHNESS_TIME_S = 2.0
_SLOPE_TIME_S = 5.0
_EDGE_S = 0.1
_LEAST_VARIANCE = 1e-8


@dataclass(frozen=True, slots=True)
class GroundGuess:
    """The guess at N ticks.

    Attributes:
        share: alpha; 0 as long as no rest has been seen.
        rest_m_s2: forward force of a rover at rest there.
        rest_variance_m2_s4: its variance; never 0.
        pitch_variance_rad2: what the guess adds to the variance of the pitch.
        walk_m2_s3: what it adds to the variance of the speed per second.
    """

    share: Float64Array
    rest_m_s2: Float64Array
    rest_variance_m2_s4: Float64Array
    pitch_variance_rad2: Float64Array
    walk_m2_s3: Float64Array


class GroundWatch:
    """Follows the force at rest and how rough the ground is, tick by tick in order of time."""

    def __init__(self, settings: EgoMotionSettings) -> None:
        self._settings = settings
        self._roll_at_rest = math.nan
        self._roll_variance = 0.0
        self._pitch_at_rest = self._slow_pitch = math.nan
        self._largest_rad = settings.speed_sigma_m_s / _SLOPE_TIME_S / settings.gravity_m_s2
        self._rest = RestForce(round(_EDGE_S / settings.tick_s))

    def add(
        self,
        roll_rad: Float64Array,
        roll_sigma_rad: Float64Array,
        pitch_rad: Float64Array,
        force_m_s2: Float64Array,
        noise_m2_s4: Float64Array,
        still: BoolArray,
    ) -> GroundGuess:
        """Take the next ticks; NaN where there is no tilt.

        Args:
            roll_rad, roll_sigma_rad, pitch_rad: (N,) levelled.
            force_m_s2, noise_m2_s4: (N,) forward force of the block and its variance.
            still: (N,) whether the rover stands.
        """
        s = self._settings
        rough, slope, rest, variance = (np.zeros(len(still)) for _ in range(4))
        for i in range(len(still)):
            self._follow(float(roll_rad[i]), float(roll_sigma_rad[i]), bool(still[i]))
            self._rest.add(float(force_m_s2[i]), float(noise_m2_s4[i]), bool(still[i]))
            rough[i] = max(self._roll_variance, 0.0)
            slope[i] = self._slope(float(pitch_rad[i]), bool(still[i]))
            rest[i], variance[i] = self._rest.mean, self._rest.variance
        own = s.acceleration_m_s2**2
        tilt = rough + slope**2 + s.ground_tilt_rad**2
        share = np.where(np.isfinite(rest), own / (own + s.gravity_m_s2**2 * tilt), 0.0)
        return GroundGuess(
            share=share,
            rest_m_s2=np.nan_to_num(rest) - s.gravity_m_s2 * np.sin(slope),
            rest_variance_m2_s4=variance + _LEAST_VARIANCE,
            pitch_variance_rad2=share * tilt,
            walk_m2_s3=2.0 * s.ground_tilt_time_s * own * (1.0 - share)
            + 2.0 * _SLOPE_TIME_S * (share * s.gravity_m_s2 * slope) ** 2,
        )

    def _follow(self, roll: float, sigma: float, still: bool) -> None:
        """Follow the square of how far the roll is from that of the last rest."""
        if not math.isfinite(roll):
            return
        if still or math.isnan(self._roll_at_rest):
            self._roll_at_rest = roll
        fresh = (roll - self._roll_at_rest) ** 2 - sigma * sigma
        gain = self._settings.tick_s / _ROUGHNESS_TIME_S
        self._roll_variance += gain * (fresh - self._roll_variance)

    def _slope(self, pitch: float, still: bool) -> float:
        """Return how far the ground's pitch is from that of the last rest, as far as it is sure."""
        if math.isfinite(pitch):
            if still or math.isnan(self._pitch_at_rest):
                self._pitch_at_rest = self._slow_pitch = pitch
            gain = self._settings.tick_s / _SLOPE_TIME_S
            self._slow_pitch += gain * (pitch - self._slow_pitch)
        away = self._slow_pitch - self._pitch_at_rest
        sure = abs(away) - self._largest_rad
        return math.copysign(sure, away) if sure > 0.0 else 0.0


class RestForce:
    """Mean force of the present or last rest, without the ends of the rest.

    Args:
        edge: ticks at either end that do not count.
    """

    def __init__(self, edge: int) -> None:
        self._edge = edge
        self._waiting: deque[tuple[float, float]] = deque()
        self._seen = 0
        self._sum = self._noise = 0.0
        self.mean, self.variance = math.nan, 0.0

    def add(self, force_m_s2: float, noise_m2_s4: float, still: bool) -> None:
        """Take the next tick."""
        if not still:
            self._waiting.clear()
            self._seen = 0
            self._sum = self._noise = 0.0
            return
        self._waiting.append((force_m_s2, noise_m2_s4))
        if len(self._waiting) <= 2 * self._edge:
            return
        force, noise = self._waiting[self._edge]
        self._waiting.popleft()
        self._seen += 1
        self._sum += force
        self._noise += noise
        self.mean = self._sum / self._seen
        self.variance = self._noise / self._seen**2
