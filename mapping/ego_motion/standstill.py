"""Whether the rover stands: the vibration is quiet, and the wheels do not turn.

Vibration is measured in units of its level at rest, which is learned: while the wheels say that
they stand, or, without wheels, in the first second. Two thresholds, so that it does not flicker.
A quiet time counts without its ends: there the rover may still, or already, creep.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from scipy.ndimage import uniform_filter1d

from mapping.ego_motion.blocks import Blocks
from mapping.ego_motion.settings import EgoMotionSettings
from mapping.geometry import Float64Array

BoolArray = np.ndarray[tuple[int], np.dtype[np.bool_]]

_LEARN_AFTER_S = 0.5
_LEARN_FIRST_S = 1.0
_LEARN_OVER_S = 5.0
_STUCK_AFTER_S = 0.5


@dataclass(frozen=True, slots=True)
class Motionless:
    """What the detector says of N ticks.

    Attributes:
        quiet: the vibration is at its level at rest.
        moving: it is clearly above.
        standing: the wheels do not turn.
        stuck: they do not, though the vibration has said for a while that the rover moves.
        excess_m_s2: RMS vibration beyond the level at rest; NaN where unknown.
    """

    quiet: BoolArray
    moving: BoolArray
    standing: BoolArray
    stuck: BoolArray
    excess_m_s2: Float64Array

    def joined(self, other: Motionless) -> Motionless:
        """Return what was said of these ticks and of others behind them."""
        return Motionless(
            *(
                np.concatenate([getattr(self, item.name), getattr(other, item.name)])
                for item in fields(self)
            )
        )

    def part(self, chosen: slice) -> Motionless:
        """Return what was said of some of the ticks."""
        return Motionless(*(getattr(self, item.name)[chosen] for item in fields(self)))


def nothing_known(size: int) -> Motionless:
    """Return what is said of ticks at which nothing was heard."""
    no = np.zeros(size, np.bool_)
    return Motionless(no, no, no, no, np.full(size, np.nan))


class MotionDetector:
    """Tells motion from rest, tick by tick in order of time."""

    def __init__(self, settings: EgoMotionSettings) -> None:
        self._settings = settings
        self._tick_s = settings.tick_s
        self._elapsed_s = 0.0
        self._standing_s = 0.0
        self._conflict_s = 0.0
        self._rest_m_s2: float | None = None
        self._learned_s = 0.0
        self._quiet = False

    @property
    def rest_m_s2(self) -> float:
        """RMS vibration at rest, as far as it is known."""
        if self._rest_m_s2 is None:
            return self._settings.quiet_m_s2 / self._settings.still_ratio
        return self._rest_m_s2

    def add(
        self, level_m_s2: Float64Array, speed_m_s: Float64Array, wheels_ok: BoolArray
    ) -> Motionless:
        """Take the next ticks.

        Args:
            level_m_s2: (N,) RMS vibration; NaN where unknown.
            speed_m_s, wheels_ok: (N,) of the wheels, and whether they report.
        """
        size = len(level_m_s2)
        quiet, moving, stuck = (np.zeros(size, np.bool_) for _ in range(3))
        standing = wheels_ok & (np.abs(speed_m_s) < self._settings.still_speed_m_s)
        excess = np.full(size, np.nan)
        for i in range(size):
            level = float(level_m_s2[i])
            self._learn(level, bool(wheels_ok[i]), bool(standing[i]))
            quiet[i], moving[i] = self._judge(level)
            known = self._rest_m_s2 is not None
            shaken = level > self._settings.stuck_ratio * self.rest_m_s2
            conflict = known and shaken and bool(standing[i])
            self._conflict_s = self._conflict_s + self._tick_s if conflict else 0.0
            stuck[i] = self._conflict_s > _STUCK_AFTER_S
            excess[i] = np.sqrt(max(level**2 - self.rest_m_s2**2, 0.0))
        return Motionless(quiet, moving, standing, stuck, excess)

    def _learn(self, level: float, wheels_ok: bool, standing: bool) -> None:
        self._elapsed_s += self._tick_s
        self._standing_s = self._standing_s + self._tick_s if standing else 0.0
        resting = self._standing_s > _LEARN_AFTER_S
        if not wheels_ok:
            resting = self._elapsed_s <= _LEARN_FIRST_S
        if not resting or not np.isfinite(level):
            return
        if self._rest_m_s2 is None:
            self._rest_m_s2 = level
        if level > self._settings.moving_ratio * self._rest_m_s2:
            return
        self._learned_s = min(self._learned_s + self._tick_s, _LEARN_OVER_S)
        share = self._tick_s / self._learned_s
        self._rest_m_s2 += share * (level - self._rest_m_s2)

    def _judge(self, level: float) -> tuple[bool, bool]:
        """Return (quiet, moving) with hysteresis; neither where the level is unknown."""
        if not np.isfinite(level):
            self._quiet = False
            return False, False
        rest = self.rest_m_s2
        if level < self._settings.still_ratio * rest:
            self._quiet = True
        elif level > self._settings.moving_ratio * rest:
            self._quiet = False
        return self._quiet, level > self._settings.moving_ratio * rest


def without_ends(still: BoolArray, margin: int, widest: int) -> BoolArray:
    """Return the ticks whose neighbours up to `margin` away are still as well.

    Args:
        still: (N + 2 widest,).
        margin: ticks on either side, up to `widest`.
        widest: ticks that are there on either side of those to judge.
    """
    windows = np.lib.stride_tricks.sliding_window_view(still, 2 * widest + 1)
    return np.asarray(windows[:, widest - margin : widest + margin + 1].all(axis=1))


def since_they_began(stuck: BoolArray, widest: int, tick_s: float) -> BoolArray:
    """Return the ticks whose wheels are stuck, or will turn out to have been since before.

    Args:
        stuck: (N + 2 widest,).
        widest: ticks that are there on either side of those to judge; it is looked ahead as far
            as that, but not further than `stuck` comes late.
        tick_s: distance of the ticks.
    """
    late = min(widest, round(_STUCK_AFTER_S / tick_s))
    windows = np.lib.stride_tricks.sliding_window_view(stuck[widest:], widest + 1)
    return np.asarray(windows[:, : late + 1].any(axis=1))


def vibration_level(blocks: Blocks, half: int) -> Float64Array:
    """Return the (N,) RMS vibration around every block, summed over the axes; NaN where unknown.

    Of accelerations: the variance within and between the blocks up to `half` away; else what
    the vibration sensor tells.
    """
    width = 2 * half + 1
    some = (blocks.count > 0).astype(np.float64)
    share = uniform_filter1d(some, width, mode="constant")

    def mean(values: Float64Array) -> Float64Array:
        """Return the (N,) running mean over the blocks with samples; NaN where most have none."""
        total = uniform_filter1d(values * some, width, mode="constant")
        result: Float64Array = np.full(len(total), np.nan)
        np.divide(total, share, out=result, where=share > 0.5)
        return result

    force = blocks.force_m_s2
    between = sum(mean(axis**2) - mean(axis) ** 2 for axis in force.T)
    own = np.sqrt(np.maximum(mean(blocks.scatter_m2_s4) + between, 0.0))
    return np.asarray(np.where(np.isfinite(own), own, blocks.vibration_m_s2), np.float64)
