"""What a frame aligned with the map knows of its pose, and what it leaves alone."""

from __future__ import annotations

import numpy as np
import pytest

from mapping.alignment.fusion import fuse_pose, moved, pose_difference
from mapping.alignment.settings import AlignmentSettings
from mapping.errors import MappingError
from mapping.geometry import UncertainPose
from mapping.settings import MapSettings
from tests.mapping.alignment.ground import SETTINGS, Site, bumps, plane

# 30 mm and 1.2 degrees.
ERROR = np.array([0.02, -0.015, 0.016, np.radians(0.7), np.radians(-0.8), np.radians(0.6)])


def test_bumps_fix_all_six() -> None:
    site = Site(bumps)
    site.build()
    truth = site.pose(0.12, 3.0, 1.0)
    found = site.align(truth, ERROR)
    assert found is not None
    assert found.directions.shape == (6, 6)
    left = pose_difference(found.pose.transform, truth)
    assert np.linalg.norm(left[:3]) < 0.002
    assert np.degrees(np.linalg.norm(left[3:])) < 0.1
    sigma = np.sqrt(np.diag(found.pose.covariance))
    assert (np.abs(left) < 3.0 * sigma).all()
    assert (sigma[:3] >= SETTINGS.floor_m).all()
    assert (sigma[3:] >= SETTINGS.floor_rad).all()


def test_a_plane_leaves_x_y_and_yaw_alone() -> None:
    site = Site(plane(0.0))
    site.build()
    truth = site.pose(0.12, 3.0)
    found = site.align(truth, ERROR)
    assert found is not None
    assert found.directions.shape == (6, 3)
    left = pose_difference(found.pose.transform, moved(truth, ERROR))
    # The normal of the map's plane is level only to its noise.
    assert np.abs(left[:2]).max() < 5e-4
    assert abs(left[5]) < np.radians(0.03)
    assert np.linalg.norm(left[2:5] + ERROR[2:5]) < 0.002
    assert found.pose.covariance[0, 0] > 1e5


def test_a_slope_is_found_again_from_a_shifted_prior() -> None:
    """Only the distance from the slope is known: its points come to lie on it, no more."""
    slope = 0.2
    site = Site(plane(slope))
    site.build()
    truth = site.pose(0.12)
    found = site.align(truth, np.array([0.02, 0.02, 0.02, 0.01, 0.01, 0.01]))
    assert found is not None
    assert found.directions.shape == (6, 3)
    normal = np.array([-slope, 0.0, 1.0]) / np.hypot(slope, 1.0)
    x, y = np.array([1.0, 1.0, 2.0, 2.0]), np.array([-0.4, 0.4, -0.8, 0.8])
    on_slope = np.stack([x, y, slope * x], axis=-1)
    seen = (found.pose.transform @ truth.inverse()).apply(on_slope)
    assert np.abs(seen @ normal).max() < 0.002
    # Along the slope nothing was corrected: two centimetres are still there.
    assert np.linalg.norm(seen - on_slope, axis=1).min() > 0.015


def test_the_form_of_three_moves_no_other() -> None:
    site = Site(bumps, alignment=AlignmentSettings(form="z-roll-pitch"))
    site.build()
    truth = site.pose(0.12, 3.0)
    error = ERROR * np.array([0.0, 0.0, 1.0, 1.0, 1.0, 0.0])
    found = site.align(truth, error)
    assert found is not None
    moved_by = pose_difference(found.pose.transform, moved(truth, error))
    assert (moved_by[:2] == 0.0).all()
    assert abs(moved_by[5]) < 2e-4  # rotations about level axes do not quite commute
    assert np.linalg.norm(moved_by[2:5] + error[2:5]) < 0.001


def test_an_empty_map_says_nothing() -> None:
    site = Site(bumps)
    assert site.align(site.pose(0.0), np.zeros(6)) is None


def test_a_map_that_is_out_of_view_says_nothing() -> None:
    site = Site(bumps)
    site.build()
    assert site.align(site.pose(0.0, 180.0), np.zeros(6)) is None


def test_a_window_that_scrolls_gives_the_same_bits() -> None:
    poses = []
    for settings in (MapSettings(), MapSettings(grid="scrolling", window_m=10.0)):
        site = Site(bumps, settings)
        site.build()
        found = site.align(site.pose(0.12, 3.0), ERROR)
        assert found is not None
        poses.append(found.pose.transform)
    assert (poses[0].rotation == poses[1].rotation).all()
    assert (poses[0].translation_m == poses[1].translation_m).all()


@pytest.mark.parametrize(("sigma_m", "limit_m"), [(0.001, 0.001), (0.03, 0.005)])
def test_a_perfect_prior_stays_where_it_is(sigma_m: float, limit_m: float) -> None:
    """The map is built from the aligned poses themselves, each from a prior without error."""
    site = Site(bumps)
    site.build(2)
    covariance = np.diag([sigma_m**2] * 3 + [(0.7 * sigma_m) ** 2] * 3)
    worst = 0.0
    for n in range(12):
        truth = site.pose(0.02 * n, n - 8.0, 0.5 * np.sin(n))
        found = site.align(truth, np.zeros(6))
        assert found is not None
        fused = fuse_pose(UncertainPose(0, truth, covariance), found, SETTINGS).transform
        site.add(fused)
        worst = max(worst, float(np.linalg.norm(pose_difference(fused, truth)[:3])))
    assert worst < limit_m


@pytest.mark.parametrize(
    ("name", "value"),
    [("floor_m", 0.0), ("cut_m", np.inf), ("iterations", 0), ("form", "5-dof")],
)
def test_impossible_settings_are_refused(name: str, value: object) -> None:
    with pytest.raises(MappingError, match=name):
        AlignmentSettings(**{name: value})  # type: ignore[arg-type] # wrong on purpose
