"""The closed-form ground against its formula, written out slowly."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulation.terrain.analytic import AnalyticTerrain, crater_field

NO_WAVES = np.empty((0, 4))
BUMP = AnalyticTerrain(np.array([[1.0, -2.0, 0.3, 0.5]]), NO_WAVES)


def _slow_height(terrain: AnalyticTerrain, x: float, y: float) -> float:
    height = 0.0
    for bump_x, bump_y, top, radius in terrain.bumps.tolist():
        r2 = (x - bump_x) ** 2 + (y - bump_y) ** 2
        if r2 < radius**2:
            height += top * (1.0 - r2 / radius**2) ** 3
    for k_x, k_y, amplitude, phase in terrain.waves.tolist():
        height += amplitude * math.sin(k_x * x + k_y * y + phase)
    return height


@given(st.floats(-2.0, 6.0), st.floats(-3.0, 3.0), st.integers(0, 20))
def test_heights_follow_the_formula(x: float, y: float, seed: int) -> None:
    terrain = crater_field(seed, 5.0, 4.0)
    found = float(terrain.height_m(np.array(x), np.array(y)))
    assert found == pytest.approx(_slow_height(terrain, x, y), abs=1e-12)


def test_a_bump_has_its_height_in_the_middle_and_ends_smoothly() -> None:
    x = np.array([1.0, 1.5 - 1e-3, 1.5, 1.6])
    found = BUMP.height_m(x, np.full(4, -2.0))
    assert found[0] == pytest.approx(0.3)
    # (1 - r^2/R^2)^3 with r = R - 1 mm: the third power of 4e-3.
    assert 0.0 < found[1] < 0.3 * 4.1e-3**3
    assert found[2] == found[3] == 0.0


def test_coordinates_are_broadcast_against_each_other() -> None:
    x, y = np.linspace(0.5, 1.5, 4), np.linspace(-2.5, -1.5, 3)
    found = BUMP.height_m(x[np.newaxis, :], y[:, np.newaxis])
    assert found.shape == (3, 4)
    assert found[2, 1] == BUMP.height_m(x[1:2], y[2:3])[0]


def test_a_seed_is_one_terrain() -> None:
    first, again, other = (crater_field(seed, 5.0, 4.0) for seed in (3, 3, 4))
    assert first.bumps.tobytes() == again.bumps.tobytes()
    assert first.waves.tobytes() == again.waves.tobytes()
    assert first.bumps.tobytes() != other.bumps.tobytes()


def test_craters_are_hollow_with_a_rim_above_the_ground() -> None:
    terrain = crater_field(7, 5.0, 4.0)
    rim, bowl = terrain.bumps[0], terrain.bumps[1]
    alone = AnalyticTerrain(np.array([rim, bowl]), NO_WAVES)
    r = np.linspace(0.0, rim[3], 200)
    profile = alone.height_m(rim[0] + r, np.full(200, rim[1]))
    diameter = 2.0 * r[np.argmax(profile)]
    assert profile[0] < 0.0 < profile.max()
    assert 0.4 < diameter < 1.4
    assert 0.08 < (profile.max() - profile[0]) / diameter < 0.14
