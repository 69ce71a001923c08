"""Roll and pitch from accelerations, made up and real."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mapping.ego_motion.blocks import force_blocks
from mapping.ego_motion.levelling import fit_lines, level
from mapping.ego_motion.settings import EgoMotionSettings
from mapping.ego_motion.tilt import angles, from_pose, rotation, rotation_jacobian, to_pose
from mapping.geometry import Float64Array

HALF = 20
tilts = st.floats(-0.6, 0.6)


def gravity(roll: float, pitch: float) -> Float64Array:
    return np.asarray(rotation(roll, pitch, 0.0).T @ np.array([0.0, 0.0, 9.8]), np.float64)


@given(tilts, tilts)
def test_a_chip_at_rest_is_levelled_exactly(roll: float, pitch: float) -> None:
    force = np.tile(gravity(roll, pitch), (2 * HALF + 1, 1))
    found = level(force, np.ones(2 * HALF + 1), HALF, 0.02, 0.25, 0.0005)
    assert found.roll_rad[0] == pytest.approx(roll, abs=1e-9)
    assert found.pitch_rad[0] == pytest.approx(pitch, abs=1e-9)
    assert found.roll_sigma_rad[0] == pytest.approx(0.0005, rel=0.01)


def test_a_steady_change_is_followed_without_lag() -> None:
    pitch = 0.1 * 0.02 * np.arange(-HALF, HALF + 1)  # 0.1 rad/s
    force = np.array([gravity(0.0, p) for p in pitch])
    found = level(force, np.ones(len(force)), HALF, 0.02, 0.25, 0.0005)
    assert found.pitch_rad[0] == pytest.approx(0.0, abs=1e-6)
    assert found.pitch_rate_rad_s[0] == pytest.approx(0.1, rel=1e-3)
    assert found.roll_rate_rad_s[0] == pytest.approx(0.0, abs=1e-9)


def test_missing_blocks_make_it_less_sure_and_then_silent() -> None:
    rng = np.random.default_rng(1)
    force = np.array([0.0, 0.0, 9.8]) + 0.3 * rng.standard_normal((2 * HALF + 1, 3))
    weight = np.ones(len(force))
    whole = level(force, weight, HALF, 0.02, 0.25, 0.0005)
    weight[: HALF + 1] = 0.0
    half = level(force, weight, HALF, 0.02, 0.25, 0.0005)
    assert half.roll_sigma_rad[0] > 1.2 * whole.roll_sigma_rad[0]
    weight[:-3] = 0.0
    assert np.isnan(level(force, weight, HALF, 0.02, 0.25, 0.0005).roll_rad[0])


@given(tilts, tilts, st.floats(-3.0, 3.0))
def test_angles_undo_rotation(roll: float, pitch: float, yaw: float) -> None:
    np.testing.assert_allclose(angles(rotation(roll, pitch, yaw)), [roll, pitch, yaw], atol=1e-12)


@given(tilts, tilts, st.floats(-3.0, 3.0))
def test_the_jacobian_turns_small_angles_into_rotations_about_t(
    roll: float, pitch: float, yaw: float
) -> None:
    small = 1e-6 * np.array([1.0, -2.0, 3.0])
    before = rotation(roll, pitch, yaw)
    after = rotation(roll + small[0], pitch + small[1], yaw + small[2])
    turned = Rotation.from_matrix(after @ before.T).as_rotvec()
    jacobian = rotation_jacobian(pitch, yaw)
    np.testing.assert_allclose(jacobian @ small, turned, atol=1e-11)
    by_hand = [np.cos(yaw) * np.tan(pitch), np.sin(yaw) * np.tan(pitch), 1.0]
    np.testing.assert_allclose(np.linalg.inv(jacobian)[2], by_hand, atol=1e-12)


def test_a_pose_and_back() -> None:
    covariance = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]) + 0.5
    vector = np.array([1.0, 2.0, 3.0, 0.1, -0.2, 2.0])
    pose = to_pose(7, vector, covariance)
    again, back = from_pose(pose.transform, pose.covariance)
    np.testing.assert_allclose(again, vector, atol=1e-12)
    np.testing.assert_allclose(back, covariance, atol=1e-12)


@pytest.mark.parametrize("name", ["360", "slam"])
def test_a_real_robot_is_levelled_within_the_stated_sigma(real_data: Path, name: str) -> None:
    """The Kinect of a Pioneer robot (Sturm et al. 2012) against motion capture.

    One constant rotation between accelerometer and markers is fitted: it is in no data sheet.
    """
    stem = real_data / "tum_fr2_pioneer" / f"rgbd_dataset_freiburg2_pioneer_{name}"
    # numpy unpacks .gz itself.
    force = np.loadtxt(f"{stem}_accelerometer.txt.gz")[:20000]
    poses = np.loadtxt(f"{stem}_groundtruth.txt.gz")[:14000]
    start_s = poses[0, 0]
    t_ns = np.rint((force[:, 0] - start_s) * 1e9).astype(np.int64)
    seconds = poses[:, 0] - start_s
    ticks_ns = np.arange(0, round(min(t_ns[-1] * 1e-9, seconds[-1]) / 0.02)) * 20_000_000
    mean, count, _, _ = force_blocks(t_ns, force[:, 1:], ticks_ns, 20_000_000, 25.0)
    fitted, _, variance, share = fit_lines(mean, (count > 0).astype(float), HALF)
    wanted = ticks_ns[HALF:-HALF] * 1e-9
    up = Rotation.from_quat(poses[:, 4:]).inv().apply([0.0, 0.0, 1.0])
    true = np.column_stack([np.interp(wanted, seconds, axis) for axis in up.T])
    gap_s = np.diff(seconds)[np.clip(np.searchsorted(seconds, wanted), 1, len(seconds) - 1) - 1]
    known = (gap_s < 0.05) & (share > 0.9)
    size = np.linalg.norm(fitted, axis=1)
    found = fitted[known] / size[known, np.newaxis]
    turn, _ = Rotation.align_vectors(true[known], found)
    residual = np.linalg.norm(np.cross(turn.apply(found), true[known]), axis=1)
    s = EgoMotionSettings()
    per_axis = s.levelling_sigma_ratio**2 * variance[known].sum(axis=1) / 2.0 / size[known] ** 2
    sigma = np.sqrt(per_axis + s.levelling_bias_rad**2)
    scaled = residual / sigma
    print(
        f"{name}: median residual {np.degrees(np.median(residual)):.2f} deg, sigma "
        f"{np.degrees(np.median(sigma)):.2f} deg per axis, within 1 / 3 sigma "
        f"{(scaled < 1.515).mean():.3f} / {(scaled < 3.439).mean():.3f}"
    )
    assert np.degrees(np.median(residual)) < 1.3
    # Of two axes: 68.3 % and 99.7 % are within 1.515 and 3.439 sigma.
    assert 0.6 < (scaled < 1.515).mean() < 0.85
    assert (scaled < 3.439).mean() > 0.9
