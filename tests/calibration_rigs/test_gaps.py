"""Silences of a sensor: found, told, left out, drawn through."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_rigs.static_rig.gaps import Gap, away_from, bridged, describe_gaps, gaps_of


def test_what_is_a_gap_depends_on_the_usual_step() -> None:
    fast, slow = np.arange(0.0, 9.0, 0.005), np.arange(0.0, 9.0, 0.2)
    assert gaps_of(fast) == gaps_of(slow) == gaps_of(fast[:1]) == ()
    assert gaps_of(np.delete(fast, slice(100, 119))) == ()  # 0.1 s
    (gap,) = gaps_of(np.delete(fast, slice(100, 120)))
    assert gap.begin_s == pytest.approx(0.495)
    assert gap.length_s == pytest.approx(0.105)
    assert gaps_of(np.delete(slow, 10)) == ()
    assert [gap.length_s for gap in gaps_of(np.delete(slow, [10, 11, 12]))] == pytest.approx([0.8])


def test_the_grid_keeps_away_and_the_bridge_is_straight() -> None:
    t_s = np.delete(np.arange(0.0, 4.0, 0.01), slice(101, 200))
    left = away_from(np.arange(0.0, 4.0, 0.1), gaps_of(t_s), 0.25)
    assert left[left < 1.5].max() == pytest.approx(0.7)
    assert left[left > 1.5].min() == pytest.approx(2.3)
    everywhere, values = bridged(t_s, 3.0 * t_s)
    np.testing.assert_allclose(np.diff(everywhere), 0.01, rtol=1e-6)
    np.testing.assert_allclose(values, 3.0 * everywhere)
    assert bridged(t_s[:50], t_s[:50])[0].size == 50


def test_gaps_are_one_line() -> None:
    assert describe_gaps([Gap(7.4, 10.6)]) == "no samples for 3.20 s, 7.40 s after the first"
    assert describe_gaps([Gap(1.0, 2.0), Gap(7.4, 10.6)]) == (
        "no samples in 2 gaps, 4.20 s together, the longest of 3.20 s, 7.40 s after the first"
    )
