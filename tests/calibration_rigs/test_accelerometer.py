"""Accelerometer calibration against a real data set with published results, and made-up ones."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration_rigs.errors import RigError
from calibration_rigs.static_rig.accelerometer import (
    STANDARD_GRAVITY_M_S2,
    calibrate_accelerometer,
    mean_readings,
)
from calibration_rigs.static_rig.rest import quiet_spread, rest_stretches

# Tedaldi et al. calibrated the sensor in Padova, where gravity is 9.81744 m/s^2.
PADOVA_M_S2 = 9.81744
XSENS_SCALE = [414.42, 412.03, 414.62]
XSENS_BIAS = [33123.8, 33275.2, 32364.5]

SCALE = np.array([410.0, 415.0, 405.0])
BIAS = np.array([32_000.0, 33_000.0, 32_500.0])
CROOKED = np.array([0.004, -0.01, 0.02])


def _readings(attitudes: int, crooked: np.ndarray, noise: float = 0.0) -> np.ndarray:
    """Return readings of a sensor with known faults in random attitudes."""
    rng = np.random.default_rng(attitudes)
    up = Rotation.random(attitudes, random_state=3).apply([0.0, 0.0, STANDARD_GRAVITY_M_S2])
    a, b, c = crooked
    straight = np.array([[1.0, -a, b], [0.0, 1.0, -c], [0.0, 0.0, 1.0]])
    clean = SCALE * (np.linalg.inv(straight) @ up.T).T + BIAS
    return np.asarray(clean + noise * rng.normal(size=clean.shape))


def test_a_real_sensor_comes_out_as_published(real_data: Path) -> None:
    with gzip.open(real_data / "imu_tk_xsens" / "xsens_acc.txt.gz", "rt") as file:
        table = np.loadtxt(file)
    t_s, counts = table[:, 0], table[:, 1:]
    threshold = 4.0 * quiet_spread(t_s, counts)
    rests = rest_stretches(t_s, counts, threshold=threshold)
    assert len(rests) == 38
    found = calibrate_accelerometer(mean_readings(counts, rests), PADOVA_M_S2)
    assert found.scale == pytest.approx(XSENS_SCALE, rel=1e-4)
    assert found.bias == pytest.approx(XSENS_BIAS, rel=1e-5)
    assert found.residual_m_s2 < 0.002


def test_known_faults_are_found() -> None:
    found = calibrate_accelerometer(_readings(20, CROOKED))
    assert found.scale == pytest.approx(SCALE, rel=1e-9)
    assert found.bias == pytest.approx(BIAS, rel=1e-9)
    assert found.crooked_rad == pytest.approx(CROOKED, abs=1e-9)
    force = found.force_m_s2(_readings(20, CROOKED))
    assert np.linalg.norm(force, axis=1) == pytest.approx(STANDARD_GRAVITY_M_S2)


def test_six_attitudes_give_scale_and_bias_without_a_sigma() -> None:
    sides = np.vstack([np.eye(3), -np.eye(3)]) * STANDARD_GRAVITY_M_S2
    found = calibrate_accelerometer(SCALE * sides + BIAS)
    assert found.scale == pytest.approx(SCALE, rel=1e-9)
    assert found.bias == pytest.approx(BIAS, rel=1e-9)
    assert found.crooked_rad.tolist() == [0.0, 0.0, 0.0]
    assert np.isinf(found.scale_sigma).all()


def test_the_sigmas_hold_the_truth() -> None:
    found = calibrate_accelerometer(_readings(40, CROOKED, noise=2.0))
    assert np.all(np.abs(found.scale - SCALE) < 3.5 * found.scale_sigma)
    assert np.all(np.abs(found.bias - BIAS) < 3.5 * found.bias_sigma)
    assert found.scale_sigma.max() < 0.3


def test_too_few_attitudes_or_one_side_only_are_refused() -> None:
    with pytest.raises(RigError, match="5 attitudes at rest; expected 6 or more"):
        calibrate_accelerometer(_readings(5, CROOKED))
    level = _readings(20, CROOKED) * [1.0, 1.0, 0.0]
    with pytest.raises(RigError, match="turn the sensor to its other sides"):
        calibrate_accelerometer(level)


def test_rest_is_what_is_quiet_long_enough() -> None:
    t_s = np.arange(0.0, 20.0, 0.01)
    rng = np.random.default_rng(2)
    values = rng.normal(0.0, 0.01, (len(t_s), 3))
    moving = ((t_s > 5.0) & (t_s < 8.0)) | ((t_s > 9.0) & (t_s < 12.0))
    values[moving] += np.sin(20.0 * t_s[moving])[:, None]
    rests = rest_stretches(t_s, values, threshold=0.05)
    found = [(round(t_s[s.first], 1), round(t_s[s.end - 1], 1)) for s in rests]
    # The second between the motions is shorter than the two that make a rest.
    assert np.array(found) == pytest.approx(np.array([(0.5, 4.0), (13.0, 19.5)]), abs=0.11)
