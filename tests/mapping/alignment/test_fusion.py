"""A prior and an alignment as one pose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mapping.alignment.fusion import fuse_pose, moved, pose_difference
from mapping.alignment.observability import UNKNOWN_M2
from mapping.alignment.scan_to_map import Alignment
from mapping.alignment.settings import AlignmentSettings
from mapping.geometry import RigidTransform, UncertainPose

Float64Array = NDArray[np.float64]
SETTINGS = AlignmentSettings()
POSE = RigidTransform(Rotation.from_euler("ZYX", [1.0, 0.2, -0.1]).as_matrix(), np.ones(3))
SHIFT = np.array([0.01, -0.02, 0.03, 0.004, -0.005, 0.006])


def _alignment(directions: list[int], variance: float) -> Alignment:
    """Return an alignment that finds POSE moved by SHIFT along some of the axes."""
    mask = np.isin(np.arange(6), directions)
    covariance = np.diag(np.where(mask, variance, UNKNOWN_M2))
    found = UncertainPose(0, moved(POSE, np.where(mask, SHIFT, 0.0)), covariance)
    return Alignment(found, np.eye(6)[:, directions], 1000, 1.0, 3)


def _prior(seed: int) -> UncertainPose:
    """Return POSE with a full covariance, everything correlated."""
    root = np.random.default_rng(seed).standard_normal((6, 6)) * 0.02
    return UncertainPose(0, POSE, root @ root.T)


def test_a_difference_leads_back() -> None:
    np.testing.assert_allclose(pose_difference(moved(POSE, SHIFT), POSE), SHIFT, atol=1e-12)


def test_a_perfect_prior_is_not_moved_by_a_bit() -> None:
    prior = UncertainPose(0, POSE, np.zeros((6, 6)))
    fused = fuse_pose(prior, _alignment([0, 1, 2, 3, 4, 5], 1e-6), SETTINGS)
    np.testing.assert_array_equal(fused.transform.translation_m, POSE.translation_m)
    np.testing.assert_array_equal(fused.transform.rotation, POSE.rotation)
    np.testing.assert_array_equal(fused.covariance, 0.0)


def test_directions_that_are_not_fixed_keep_the_prior_whatever_it_correlates() -> None:
    fused = fuse_pose(_prior(1), _alignment([2, 3, 4], 1e-6), SETTINGS)
    left = pose_difference(fused.transform, POSE)
    np.testing.assert_array_equal(fused.transform.translation_m[:2], POSE.translation_m[:2])
    assert abs(left[5]) < 1e-12
    assert np.linalg.norm(left[2:5] - SHIFT[2:5]) < 0.2 * np.linalg.norm(SHIFT[2:5])


def test_a_prior_that_has_heard_the_map_yields_to_it() -> None:
    """It claims a tenth of a millimetre; where the points fix nothing, that stands."""
    prior = UncertainPose(0, POSE, np.eye(6) * 1e-8)
    fused = fuse_pose(prior, _alignment([2, 3, 4], 1e-6), SETTINGS, hears_map=True)
    left = pose_difference(fused.transform, POSE)
    np.testing.assert_allclose(left[2:5], SHIFT[2:5], rtol=0.02)
    np.testing.assert_array_equal(fused.transform.translation_m[:2], POSE.translation_m[:2])
    assert (np.diag(fused.covariance)[[0, 1, 5]] < 1e-7).all()


def test_it_is_the_mean_weighted_by_information() -> None:
    prior = _prior(2)
    variance = 1e-4
    fused = fuse_pose(prior, _alignment([0, 1, 2, 3, 4, 5], variance), SETTINGS)
    information = np.linalg.inv(prior.covariance) + np.eye(6) / variance
    expected = np.linalg.solve(information, SHIFT / variance)
    np.testing.assert_allclose(pose_difference(fused.transform, POSE), expected, atol=1e-9)
    np.testing.assert_allclose(fused.covariance, np.linalg.inv(information), atol=1e-9)
