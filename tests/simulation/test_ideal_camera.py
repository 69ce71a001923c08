"""Ray tracing against closed forms and against a march in tiny steps; the noise by its spread."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from drivers.samples import CameraIntrinsics
from simulation.devices.ideal_camera import noisy_depth_mm, trace
from simulation.ideal_drive import IdealDrive
from simulation.terrain.analytic import AnalyticTerrain

Float64Array = NDArray[np.float64]

FLAT = AnalyticTerrain(np.empty((0, 4)), np.empty((0, 4)))
CAMERA = CameraIntrinsics(48, 36, 43.5, 43.5, 23.5, 17.5)
# Optical frame to a body that looks along x with z up.
BODY_FROM_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def _looking(pitch_deg: float, yaw_deg: float = 0.0) -> Float64Array:
    turn = Rotation.from_euler("ZY", [yaw_deg, pitch_deg], degrees=True).as_matrix()
    rotation: Float64Array = turn @ BODY_FROM_OPTICAL
    return rotation


def _rays(rotation: Float64Array) -> Float64Array:
    """Return (height, width, 3) rays of optical z = 1 in the world."""
    x = (np.arange(CAMERA.width_px) - CAMERA.cx_px) / CAMERA.fx_px
    y = (np.arange(CAMERA.height_px) - CAMERA.cy_px) / CAMERA.fy_px
    u, v = np.meshgrid(x, y)
    rays: Float64Array = np.stack([u, v, np.ones_like(u)], axis=-1) @ rotation.T
    return rays


@pytest.mark.parametrize("pitch_deg", [25.0, 60.0, 90.0])
def test_flat_ground_has_the_distances_of_geometry(pitch_deg: float) -> None:
    rotation = _looking(pitch_deg, 30.0)
    z, angle = trace(FLAT, CAMERA, np.array([1.0, 2.0, 0.4]), rotation, 4.5)
    rays = _rays(rotation)
    with np.errstate(divide="ignore"):
        expected = np.where(rays[..., 2] < 0.0, -0.4 / rays[..., 2], np.inf)
    seen = expected <= 4.5
    np.testing.assert_array_equal(z > 0.0, seen)
    np.testing.assert_allclose(z[seen], expected[seen], atol=2e-8)
    incidence = np.arccos(-rays[..., 2] / np.linalg.norm(rays, axis=-1))
    np.testing.assert_allclose(angle[seen], incidence[seen], atol=1e-6)


def test_the_sky_and_far_ground_are_not_seen() -> None:
    up, _ = trace(FLAT, CAMERA, np.array([0.0, 0.0, 0.4]), _looking(-90.0), 4.5)
    near, _ = trace(FLAT, CAMERA, np.array([0.0, 0.0, 0.4]), _looking(90.0), 0.39)
    inside, _ = trace(FLAT, CAMERA, np.array([0.0, 0.0, -0.1]), _looking(25.0), 4.5)
    assert not up.any()
    assert not near.any()
    assert not inside.any()


def _march(terrain: AnalyticTerrain, origin: Float64Array, ray: Float64Array) -> float:
    """Return the first crossing found in steps of 0.5 mm; 0 = none."""
    s = np.arange(0.0, 4.5, 0.0005)
    points = origin + s[:, np.newaxis] * ray
    clearance = points[:, 2] - terrain.height_m(points[:, 0], points[:, 1])
    below = np.flatnonzero(clearance <= 0.0)
    if not below.size:
        return 0.0
    k = below[0]
    share = clearance[k - 1] / (clearance[k - 1] - clearance[k])
    return float(s[k - 1] + share * 0.0005)


@pytest.mark.parametrize("seed", [1, 4])
def test_the_first_hit_is_found_on_rough_ground(seed: int) -> None:
    drive = IdealDrive(seed, 3.0)
    position, rotation = drive.body_pose(1_300_000_000)
    z, _ = trace(drive.terrain, CAMERA, position, rotation, 4.5)
    rays = _rays(rotation)
    for v in range(0, CAMERA.height_px, 5):
        for u in range(0, CAMERA.width_px, 7):
            marched = _march(drive.terrain, position, rays[v, u])
            assert z[v, u] == pytest.approx(marched, abs=2e-6), (v, u)


def test_a_mound_hides_what_is_behind_it() -> None:
    mound = AnalyticTerrain(np.array([[1.5, 0.0, 0.3, 0.4]]), np.empty((0, 4)))
    rotation = _looking(10.0)
    z, _ = trace(mound, CAMERA, np.array([0.0, 0.0, 0.2]), rotation, 4.5)
    x = (z[..., np.newaxis] * _rays(rotation))[..., 0]
    middle = x[:, CAMERA.width_px // 2]
    assert not ((middle > 1.5) & (middle < 2.5)).any()
    assert ((middle > 1.1) & (middle < 1.5)).sum() > 3


def test_noise_has_the_spread_of_nguyen_2012() -> None:
    random = np.random.default_rng(5)
    z, theta = 2.0, np.radians(60.0)
    # 0.0012 + 0.0019 * 1.6^2 + 0.0001 / sqrt(2) * (60 / 30)^2, by hand.
    sigma = 0.0012 + 0.004864 + 0.000282843
    shape = (500, 600)
    depth = noisy_depth_mm(np.full(shape, z), np.full(shape, theta), random)
    error = depth.astype(np.float64) / 1000.0 - z
    assert error.mean() == pytest.approx(0.0, abs=4 * sigma / np.sqrt(error.size))
    # Rounding to millimetres adds 1/12 mm^2; 300000 draws leave 0.13 % of sigma.
    assert error.std() == pytest.approx(np.hypot(sigma, 0.001 / np.sqrt(12.0)), rel=0.006)


def test_nothing_seen_stays_nothing_and_a_seed_is_one_image() -> None:
    z = np.array([[0.0, 1.0], [2.0, 0.0]])
    images = [noisy_depth_mm(z, np.zeros((2, 2)), np.random.default_rng(8)) for _ in range(2)]
    np.testing.assert_array_equal(images[0] > 0, z > 0.0)
    np.testing.assert_array_equal(images[0], images[1])
    assert images[0].dtype == np.uint16


def test_grazing_rays_are_noisy_but_not_without_limit() -> None:
    z = np.full((200, 200), 1.0)
    depth = noisy_depth_mm(z, np.full((200, 200), np.pi / 2.0), np.random.default_rng(2))
    # Held at 84 deg: 0.0012 + 0.0019 * 0.36 + 0.0001 * 14^2.
    assert (depth / 1000.0).std() == pytest.approx(0.0012 + 0.000684 + 0.0196, rel=0.02)
