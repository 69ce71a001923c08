"""Gyro scale from turns and bias over temperature, from made-up rates whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from calibration_rigs.errors import RigError
from calibration_rigs.static_rig.gyro import Turn, gyro_scale, temperature_slope, turns_between
from calibration_rigs.static_rig.rest import Stretch

RATE_HZ = 200.0
NOISE_RAD_S = 0.002


def _turning(
    scale: float, angles_rad: list[float], seed: int
) -> tuple[np.ndarray, np.ndarray, list[Stretch]]:
    """Return time, rate and rests: 3 s of rest around each turn of 2 s; the bias drifts."""
    rng = np.random.default_rng(seed)
    true: list[float] = []
    rests = []
    for angle in [*angles_rad, 0.0]:
        rests.append(Stretch(len(true), len(true) + 600))
        true += [0.0] * 600
        if angle:
            true += [angle / 2.0] * 400
    rate = np.array(true) / scale
    bias = 0.01 + 0.0002 * np.arange(len(rate)) / RATE_HZ
    noise = rng.normal(0.0, NOISE_RAD_S, len(rate))
    return np.arange(len(rate)) / RATE_HZ, rate + bias + noise, rests


def test_known_turns_give_the_scale_within_its_sigma() -> None:
    misses = []
    for seed in range(30):
        angles = [np.pi / 2.0, -np.pi / 2.0, np.pi, -np.pi]
        turns = turns_between(*_turning(1.03, angles, seed))
        found = gyro_scale(turns, angles)
        misses.append((found.scale.value - 1.03) / found.scale.sigma)
    assert found.scale.sigma < 0.001
    assert np.mean(np.abs(misses) < 1.96) >= 0.85
    assert abs(np.mean(misses)) < 0.6


def test_angles_that_do_not_match_the_turns_are_refused() -> None:
    turns = [Turn(1.5, 0.01), Turn(-1.5, 0.01)]
    with pytest.raises(RigError, match="2 turns between times of rest and 1 known angles"):
        gyro_scale(turns, [1.57])
    with pytest.raises(RigError, match="which way the sensing axis points"):
        gyro_scale(turns, [1.57, 1.57])


def test_turns_that_scatter_widen_the_sigma() -> None:
    calm = gyro_scale([Turn(1.5, 0.01), Turn(1.5, 0.01)], [1.5, 1.5])
    wild = gyro_scale([Turn(1.5, 0.01), Turn(1.5, 0.01)], [1.4, 1.6])
    assert wild.scale.sigma > 5.0 * calm.scale.sigma
    assert wild.residual_rad == pytest.approx(0.1)


def test_the_bias_follows_the_temperature() -> None:
    t_s = np.arange(0.0, 600.0, 0.1)
    temperature = 20.0 + t_s / 60.0
    rng = np.random.default_rng(5)
    rate = 0.01 + 3e-4 * (temperature - 25.0) + rng.normal(0.0, NOISE_RAD_S, len(t_s))
    found = temperature_slope(t_s, rate, temperature)
    assert found.per_c.value == pytest.approx(3e-4, abs=3.0 * found.per_c.sigma)
    assert found.per_c.sigma < 2e-5
    at_25 = found.at_middle.value + found.per_c.value * (25.0 - found.middle_c)
    assert at_25 == pytest.approx(0.01, abs=1e-4)


def test_a_temperature_that_does_not_move_says_nothing() -> None:
    t_s = np.arange(0.0, 600.0, 0.1)
    with pytest.raises(RigError, match="record from a cold start on"):
        temperature_slope(t_s, np.zeros_like(t_s), np.full_like(t_s, 21.0))
