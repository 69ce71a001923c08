"""Sigma against what came of errors that the mapper did not see, in two short drives."""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from benchmarks.coverage_worlds import constant_draws, judge_world, pooled

_FRAMES = 80


def test_two_worlds_are_within_their_sigma_and_a_naive_one_is_not() -> None:
    """Constant errors of 0.8 sigma with both signs: what one draw of them does is known."""
    constant = np.array([0.8, -0.8, 0.8, -0.8])
    judged = [judge_world(seed, _FRAMES, (-1) ** seed * constant) for seed in (1, 2)]
    rows = pooled(judged)
    honest, naive = rows["all"], rows["naive"]
    assert honest.cells > 10_000
    assert honest.coverage_3sigma >= 0.985
    assert 0.4 <= honest.anees <= 1.4
    assert naive.coverage_3sigma < 0.9
    assert naive.anees > 3.0
    for name, row in rows.items():
        if name.startswith(("slope", "range")) and row.cells > 100:
            assert row.coverage_3sigma >= 0.97, name


def test_the_draws_of_twenty_worlds_stand_for_all() -> None:
    draws = constant_draws(20)
    np.testing.assert_allclose(np.sort(draws, axis=0)[:, 0], norm.ppf((np.arange(20) + 0.5) / 20))
    assert np.abs(np.corrcoef(draws.T) - np.eye(4)).max() < 0.6
