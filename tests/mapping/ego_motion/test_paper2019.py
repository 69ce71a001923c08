"""The paper's equations as printed, by hand and against what they lack."""

from __future__ import annotations

import numpy as np
import pytest

from mapping.ego_motion.paper2019 import (
    PaperState,
    paper_omega,
    paper_path,
    paper_start,
    paper_step,
)
from mapping.errors import MappingError

OMEGA = np.diag([0.01, 0.02, 0.03, 0.04])


def test_one_step_by_hand() -> None:
    start = PaperState(np.array([1.0, 2.0, 3.0]), np.pi / 2, np.diag([1.0, 1.0, 1.0, 4.0]))
    step = paper_step(start, np.array([2.0, 0.0, 1.0]), 3.0, 0.1, OMEGA)
    # 37 and 39: 3/2 0.1^2 = 0.015; at a yaw of 90 degrees, forward is y.
    np.testing.assert_allclose(step.state.position_m, [1.0, 2.03, 3.015], atol=1e-15)
    assert step.state.yaw_rad == pytest.approx(np.pi / 2 + 0.045)
    # 44 with the printed 42: the yaw's variance is multiplied by 0.045^2, and so is forgotten.
    q = 0.015**2
    expected = [1.0 + 0.02 * q, 1.0 + 4 * 0.03**2 + 0.01 * q, 1.0 + 4 * 0.015**2 + 0.03 * q]
    np.testing.assert_allclose(step.state.covariance.diagonal()[:3], expected, rtol=1e-12)
    assert step.state.covariance[3, 3] == pytest.approx(4 * 0.045**2 + 0.04 * q)
    # 49, 54, 55
    np.testing.assert_allclose(step.relative_covariance, OMEGA * q)
    np.testing.assert_allclose(step.position_covariance, OMEGA[:3, :3] * q)
    assert step.rotation_covariance[2, 2] == pytest.approx(0.04 * q)
    assert np.count_nonzero(step.rotation_covariance) == 1


def test_equation_51_says_what_49_says() -> None:
    before = PaperState(np.zeros(3), 0.4, np.diag([1e-6, 2e-6, 3e-6, 4e-6]))
    after = paper_step(before, np.array([0.5, 0.1, -0.2]), 0.3, 0.1, OMEGA).state
    np.testing.assert_allclose(paper_omega(before, after, 0.1), OMEGA, rtol=1e-6, atol=1e-9)


def test_from_stop_to_stop_it_stays_where_it_was() -> None:
    seconds = np.arange(0.0, 10.0, 0.01)
    acceleration = np.zeros((1000, 3))
    acceleration[(seconds >= 1.0) & (seconds < 1.6), 0] = 0.5
    acceleration[(seconds >= 8.0) & (seconds < 8.6), 0] = -0.5
    driven_m = np.cumsum(np.cumsum(acceleration[:, 0]) * 0.01)[-1] * 0.01
    state = paper_path(acceleration, np.zeros(1001), 0.01, OMEGA)
    assert driven_m == pytest.approx(2.1, abs=0.01)
    assert np.abs(state.position_m).max() < 1e-15


def test_the_yaw_variance_is_that_of_the_last_step() -> None:
    state = paper_start()
    for _ in range(1000):
        state = paper_step(state, np.zeros(3), 0.0, 0.01, OMEGA).state
    kept = 1000 * 0.04 * (1.5 * 0.01**2) ** 2
    assert np.sqrt(kept / state.covariance[3, 3]) == pytest.approx(31.6, abs=0.1)


def test_the_result_depends_on_the_interval() -> None:
    def end(dt_s: float) -> float:
        count = round(1.0 / dt_s)
        path = paper_path(np.tile([1.0, 0.0, 0.0], (count, 1)), np.zeros(count + 1), dt_s, OMEGA)
        return float(path.position_m[0])

    assert end(0.1) == pytest.approx(10.0 * end(0.01))


def test_the_rate_may_be_taken_for_beta() -> None:
    rate = np.full(101, 0.2)
    still = np.zeros((100, 3))
    assert paper_path(still, rate, 0.01, OMEGA).yaw_rad == 0.0
    turned = paper_path(still, rate, 0.01, OMEGA, beta_is_rate=True).yaw_rad
    assert turned == pytest.approx(100 * 1.5 * 0.2 * 0.01**2)


def test_an_interval_of_nothing_is_refused() -> None:
    with pytest.raises(MappingError, match="expected more than 0"):
        paper_step(paper_start(), np.zeros(3), 0.0, 0.0, OMEGA)
