"""A depth camera without optics' faults: exact ranges by ray tracing, then Nguyen's axial noise."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from drivers.samples import CameraIntrinsics
from simulation.terrain.analytic import AnalyticTerrain, height_at

Float64Array = NDArray[np.float64]

# A ray advances by clearance / closing speed, as if slopes up to 0.5 lay ahead, and by 2 cm over
# ground at least: far below the width of any bump, so that none is passed through unnoticed by
# more than a fraction of a millimetre.
_SLOPE_AHEAD = 0.5
_MIN_RUN_M = 0.02
_REFINEMENTS = 40
_HIT_TOLERANCE_M = 1e-7
_SLOPE_HALF_BASE_M = 1e-4


@njit(cache=True, nogil=True, error_model="numpy")
def _clearance(
    bumps: Float64Array,
    waves: Float64Array,
    origin: Float64Array,
    ray: tuple[float, float, float],
    s: float,
) -> float:
    """Return how far above the ground the ray is at parameter s, metres."""
    ground = height_at(bumps, waves, origin[0] + s * ray[0], origin[1] + s * ray[1])
    return float(origin[2] + s * ray[2] - ground)


@njit(cache=True, nogil=True, error_model="numpy")
def _distance(
    bumps: Float64Array,
    waves: Float64Array,
    origin: Float64Array,
    ray: tuple[float, float, float],
    z_max: float,
) -> float:
    """Return the ray parameter (distance along the optical axis) of the first hit; 0 = none."""
    run = np.sqrt(ray[0] * ray[0] + ray[1] * ray[1])
    shortest = _MIN_RUN_M / max(run, 0.1)
    closing = max(_SLOPE_AHEAD * run - ray[2], 1e-3)
    before = 0.0
    above = _clearance(bumps, waves, origin, ray, 0.0)
    while above > 0.0 and before <= z_max:
        s = before + max(above / closing, shortest)
        now = _clearance(bumps, waves, origin, ray, s)
        if now <= 0.0:
            return _refine(bumps, waves, origin, ray, before, above, s, now)
        before = s
        above = now
    return 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _refine(
    bumps: Float64Array,
    waves: Float64Array,
    origin: Float64Array,
    ray: tuple[float, float, float],
    s_above: float,
    above: float,
    s_below: float,
    below: float,
) -> float:
    """Return the crossing between two parameters by regula falsi (Illinois form)."""
    s = s_below
    side = 0
    for _ in range(_REFINEMENTS):
        s = (s_above * below - s_below * above) / (below - above)
        now = _clearance(bumps, waves, origin, ray, s)
        if abs(now) < _HIT_TOLERANCE_M:
            break
        if now > 0.0:
            s_above, above = s, now
            below = 0.5 * below if side == 1 else below
            side = 1
        else:
            s_below, below = s, now
            above = 0.5 * above if side == -1 else above
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
            s = s if s <= z_max else 0.0
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
        "fixed_share": 0.0,
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
