"""A depth camera without optics' faults: exact ranges by ray tracing, then Nguyen's axial noise."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from drivers.samples import CameraIntrinsics
from simulation.terrain import AnalyticTerrain, height_at

Float64Array = NDArray[np.float64]

# Steps along the ground are no longer than this, far below the width of any bump, so that a ray
# cannot pass through one; on the way down to the ground a slope of 0.5 is allowed for.
_MAX_RUN_M = 0.10
_MIN_STEP = 2e-3
_SLOPE_AHEAD = 0.5
_EXACT_M = 1e-9
_MOST_REFINEMENTS = 60
_SLOPE_HALF_BASE_M = 1e-4


@njit(cache=True, nogil=True, error_model="numpy")
def _distance(
    bumps: Float64Array,
    waves: Float64Array,
    origin: Float64Array,
    ray: tuple[float, float, float],
    z_max: float,
) -> float:
    """Return the ray parameter (distance along the optical axis) of the first hit; 0 = none."""
    dx, dy, dz = ray
    run = np.sqrt(dx * dx + dy * dy)
    longest = _MAX_RUN_M / max(run, 1e-9)
    closing = max(_SLOPE_AHEAD * run - dz, 1e-3)
    before = 0.0
    before_m = 0.0
    s = 0.0
    while before < z_max:
        clearance_m = _clearance(bumps, waves, origin, ray, s)
        if clearance_m <= 0.0:
            return _crossing(bumps, waves, origin, ray, (before, before_m), (s, clearance_m))
        before = s
        before_m = clearance_m
        s = min(s + min(max(clearance_m / closing, _MIN_STEP), longest), z_max)
    return 0.0


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _clearance(
    bumps: Float64Array,
    waves: Float64Array,
    origin: Float64Array,
    ray: tuple[float, float, float],
    s: float,
) -> float:
    """Return how far the ray is above the ground at parameter s."""
    dx, dy, dz = ray
    ground = height_at(bumps, waves, origin[0] + s * dx, origin[1] + s * dy)
    return float(origin[2] + s * dz - ground)


@njit(cache=True, nogil=True, error_model="numpy")
def _crossing(
    bumps: Float64Array,
    waves: Float64Array,
    origin: Float64Array,
    ray: tuple[float, float, float],
    above: tuple[float, float],
    below: tuple[float, float],
) -> float:
    """Return where the clearance is 0 between two (parameter, clearance): false position.

    The Illinois rule halves the clearance of an end that stays twice, so that both close in.
    """
    a, a_m = above
    b, b_m = below
    s = a
    side = 0
    for _ in range(_MOST_REFINEMENTS):
        s = (a * b_m - b * a_m) / (b_m - a_m)
        s_m = _clearance(bumps, waves, origin, ray, s)
        if abs(s_m) <= _EXACT_M:
            break
        if s_m > 0.0:
            a, a_m = s, s_m
            b_m *= 0.5 if side > 0 else 1.0
            side = 1
        else:
            b, b_m = s, s_m
            a_m *= 0.5 if side < 0 else 1.0
            side = -1
    return s


@njit(cache=True, nogil=True, error_model="numpy")
def _cosine_of_incidence(
    bumps: Float64Array, waves: Float64Array, x: float, y: float, ray: tuple[float, float, float]
) -> float:
    """Return the cosine between a ray and the ground's normal at (x, y)."""
    dx, dy, dz = ray
    h = _SLOPE_HALF_BASE_M
    slope_x = height_at(bumps, waves, x + h, y) - height_at(bumps, waves, x - h, y)
    slope_y = height_at(bumps, waves, x, y + h) - height_at(bumps, waves, x, y - h)
    slope_x /= 2.0 * h
    slope_y /= 2.0 * h
    toward = slope_x * dx + slope_y * dy - dz
    normal2 = 1.0 + slope_x * slope_x + slope_y * slope_y
    return float(toward / np.sqrt(normal2 * (dx * dx + dy * dy + dz * dz)))


@njit(cache=True, nogil=True, error_model="numpy")
def _trace(
    bumps: Float64Array,
    waves: Float64Array,
    origin: Float64Array,
    rotation: Float64Array,
    ray_x: Float64Array,
    ray_y: Float64Array,
    z_max: float,
    z: Float64Array,
    cosine: Float64Array,
) -> None:
    """Fill the distance (0 = nothing hit) and the cosine of incidence of every pixel."""
    for v in range(ray_y.shape[0]):
        for u in range(ray_x.shape[0]):
            ray = (
                rotation[0, 0] * ray_x[u] + rotation[0, 1] * ray_y[v] + rotation[0, 2],
                rotation[1, 0] * ray_x[u] + rotation[1, 1] * ray_y[v] + rotation[1, 2],
                rotation[2, 0] * ray_x[u] + rotation[2, 1] * ray_y[v] + rotation[2, 2],
            )
            s = _distance(bumps, waves, origin, ray, z_max)
            x = origin[0] + s * ray[0]
            y = origin[1] + s * ray[1]
            z[v, u] = s
            cosine[v, u] = _cosine_of_incidence(bumps, waves, x, y, ray) if s > 0.0 else 1.0


def trace(
    terrain: AnalyticTerrain,
    camera: CameraIntrinsics,
    position_m: Float64Array,
    rotation: Float64Array,
    z_max_m: float,
) -> tuple[Float64Array, Float64Array]:
    """Return exact distances and incidence angles of an image.

    Args:
        terrain: the ground.
        camera: image size and intrinsics.
        position_m: (3,) camera in the world.
        rotation: (3, 3) optical frame to world.
        z_max_m: ground beyond this distance along the optical axis is not seen.

    Returns:
        (height, width) distance along the optical axis in metres, 0 = none; and the angle between
        ray and surface normal in radians.
    """
    ray_x = (np.arange(camera.width_px, dtype=np.float64) - camera.cx_px) / camera.fx_px
    ray_y = (np.arange(camera.height_px, dtype=np.float64) - camera.cy_px) / camera.fy_px
    z = np.empty((camera.height_px, camera.width_px))
    cosine = np.empty_like(z)
    _trace(
        terrain.bumps,
        terrain.waves,
        position_m,
        rotation,
        ray_x,
        ray_y,
        z_max_m,
        z,
        cosine,
    )
    return z, np.arccos(np.clip(cosine, 0.0, 1.0))


# The axial noise of `noisy_depth_mm` in the keys of a terravibe depth noise file.
IDEAL_CAMERA_NOISE = {
    "schema": "terravibe/depth-noise",
    "version": 1,
    "device": {"model": "simulated ideal camera", "serial": ""},
    "model": {
        "name": "ideal-camera",
        "axial_offset_m": 0.0012,
        "axial_quadratic_per_m": 0.0019,
        "axial_reference_m": 0.4,
        "axial_angle_m_sqrt_m": 0.0001,
    },
}


def noisy_depth_mm(
    z_m: Float64Array, incidence_rad: Float64Array, random: np.random.Generator
) -> NDArray[np.uint16]:
    """Return a depth image in millimetres with independent Gaussian noise per pixel.

    sigma_z = 0.0012 + 0.0019 (z - 0.4)^2 + 0.0001 / sqrt(z) theta^2 / (pi/2 - theta)^2, Nguyen,
    Izadi, Lovell 2012; written out here so that the mapper's model is tested against another.
    """
    seen = z_m > 0.0
    z = np.where(seen, z_m, 1.0)
    theta = np.minimum(incidence_rad, np.radians(84.0))
    ratio2 = theta**2 / (np.pi / 2.0 - theta) ** 2
    sigma = 0.0012 + 0.0019 * (z - 0.4) ** 2 + 0.0001 / np.sqrt(z) * ratio2
    noisy_mm = np.rint((z + sigma * random.standard_normal(z.shape)) * 1000.0)
    return np.where(seen, np.clip(noisy_mm, 0, 65535), 0).astype(np.uint16)
