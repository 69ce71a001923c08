"""Motion and rest from vibration and wheels."""

from __future__ import annotations

import numpy as np

from mapping.ego_motion.settings import EgoMotionSettings
from mapping.ego_motion.standstill import (
    MotionDetector,
    Motionless,
    since_they_began,
    without_ends,
)
from mapping.geometry import Float64Array

SETTINGS = EgoMotionSettings(still_ratio=1.2, moving_ratio=1.5, stuck_ratio=2.0)


def judged(
    level: Float64Array, speed: Float64Array | None = None
) -> tuple[Motionless, MotionDetector]:
    detector = MotionDetector(SETTINGS)
    wheels_ok = np.full(len(level), speed is not None)
    given = np.zeros(len(level)) if speed is None else speed
    return detector.add(level, given, wheels_ok), detector


def test_between_the_thresholds_nothing_changes() -> None:
    level = np.concatenate([np.ones(60), np.full(20, 1.3), np.full(20, 1.8), np.full(20, 1.3)])
    found, detector = judged(level)
    assert detector.rest_m_s2 == 1.0
    assert found.quiet[:80].all()
    assert not found.quiet[80:].any()
    assert found.moving.tolist() == [False] * 80 + [True] * 20 + [False] * 20


def test_a_hole_in_the_vibration_is_neither_rest_nor_motion() -> None:
    found, _ = judged(np.concatenate([np.ones(60), np.full(5, np.nan)]))
    assert not found.quiet[60:].any()
    assert not found.moving[60:].any()
    assert np.isnan(found.excess_m_s2[60:]).all()


def test_wheels_that_stand_while_the_rover_shakes_are_stuck_after_a_while() -> None:
    level = np.concatenate([np.ones(100), np.full(60, 3.0)])
    found, _ = judged(level, np.zeros(160))
    assert not found.stuck[:124].any()
    assert found.stuck[130:].all()
    turning, _ = judged(level, np.where(np.arange(160) < 100, 0.0, 0.3))
    assert not turning.stuck.any()


def test_excess_is_what_the_rest_does_not_explain() -> None:
    found, _ = judged(np.concatenate([np.full(60, 3.0), [5.0]]))
    assert abs(found.excess_m_s2[-1] - 4.0) < 1e-9


def test_stuck_wheels_were_stuck_before_it_was_sure() -> None:
    found = np.zeros(100, np.bool_)
    found[60:70] = True
    assert np.flatnonzero(since_they_began(found, 25, 0.02)).tolist() == list(range(10, 45))
    assert not since_they_began(np.zeros(60, np.bool_), 25, 0.02).any()


def test_ends_are_taken_off() -> None:
    still = np.array([0, 1, 1, 1, 1, 1, 0, 1, 0], np.bool_)
    assert without_ends(still, 1, 1).tolist() == [False, True, True, True, False, False, False]
    assert without_ends(still, 0, 2).tolist() == still[2:-2].tolist()
