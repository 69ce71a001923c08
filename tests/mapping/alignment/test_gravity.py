"""A map that has slid is noticed; levelling that merely trembles is not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mapping.alignment.gravity import GravityCheck, GravitySettings
from mapping.errors import MappingError

PERIOD_NS = 100_000_000
UP = np.array([0.0, 0.0, 1.0])


def test_the_limit_is_three_sigma_of_the_mean() -> None:
    settings = GravitySettings()
    # 3 * 2 deg * sqrt(0.6 / 5)
    assert np.degrees(settings.limit_rad) == pytest.approx(2.0785, abs=1e-4)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_slid_map_is_noticed_when_the_window_is_full(axis: int) -> None:
    check = GravityCheck(GravitySettings())
    tilt = np.zeros(3)
    tilt[axis] = np.radians(5.0)
    turned = Rotation.from_euler("z", 40.0, degrees=True)
    rotation = (turned * Rotation.from_rotvec(tilt)).as_matrix()
    found = [check.add(n * PERIOD_NS, UP, rotation) for n in range(60)]
    assert found[:44] == [0.0] * 44
    assert np.degrees(found[-1]) == pytest.approx(5.0, abs=0.01)


def test_a_gap_empties_the_window() -> None:
    check = GravityCheck(GravitySettings())
    rotation = Rotation.from_euler("x", 5.0, degrees=True).as_matrix()
    for n in range(60):
        check.add(n * PERIOD_NS, UP, rotation)
    assert check.add(200 * PERIOD_NS, UP, rotation) == 0.0


def test_noise_of_levelling_is_no_alarm() -> None:
    """Gauss-Markov errors of the stated sigma and time on both axes, for ten minutes."""
    settings = GravitySettings()
    check = GravityCheck(settings)
    random = np.random.default_rng(3)
    kept = np.exp(-0.1 / settings.levelling_time_s)
    error = np.zeros(3)
    alarms = 0
    for n in range(6000):
        fresh = settings.levelling_sigma_rad * np.array([*random.standard_normal(2), 0.0])
        error = kept * error + np.sqrt(1.0 - kept**2) * fresh
        up = Rotation.from_rotvec(error).as_matrix() @ UP
        alarms += check.add(n * PERIOD_NS, up, np.eye(3)) > 0.0
    assert alarms < 60


def test_impossible_settings_are_refused() -> None:
    with pytest.raises(MappingError, match="window_s"):
        GravitySettings(window_s=0.0)
