"""One depth frame measured slowly in float64 numpy, straight from the formulas."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.samples import CameraIntrinsics
from mapping.measurement import SENSOR_WIDTH_PX, View
from mapping.noise import DepthNoiseModel
from tests.mapping.scenes import rays

Float64Array = NDArray[np.float64]


@dataclass(frozen=True)
class Measured:
    """Per pixel: height above the camera, its variance, and x and y relative to T in cells."""

    height_m: Float64Array
    variance_m2: Float64Array
    x_cells: Float64Array
    y_cells: Float64Array
    valid: NDArray[np.bool_]

    @property
    def cell(self) -> NDArray[np.int64]:
        """(height, width, 2) global column and row."""
        return np.floor(np.stack([self.x_cells, self.y_cells], axis=-1)).astype(np.int64)

    def off_borders(self, margin: float) -> NDArray[np.bool_]:
        """Pixels whose point is farther than `margin` cells from every border of a cell."""
        return (_from_border(self.x_cells) > margin) & (_from_border(self.y_cells) > margin)


def _from_border(cells: Float64Array) -> Float64Array:
    return np.abs(cells - np.rint(cells))


def plane_incidence(
    camera: CameraIntrinsics, rotation: Float64Array, normal: ArrayLike
) -> Float64Array:
    """Return the angle between every ray and a plane's normal, given in T."""
    r = rays(camera)
    n = rotation.T @ np.asarray(normal, float)
    cosine = np.abs(r @ n) / np.linalg.norm(r, axis=-1) / np.linalg.norm(n)
    incidence: Float64Array = np.arccos(np.clip(cosine, 0.0, 1.0))
    return incidence


def measure(
    z_m: Float64Array,
    incidence_rad: Float64Array,
    camera: CameraIntrinsics,
    noise: DepthNoiseModel,
    view: View,
    cell_size_m: float,
) -> Measured:
    """Return h = e.(C p_S) and J C Sigma_S C' J' with J = e', per pixel, one after the other."""
    rotation, position = view.T_terrain_sensor.rotation, view.T_terrain_sensor.translation_m
    points = z_m[..., np.newaxis] * rays(camera) @ rotation.T
    focal_px = camera.fx_px * SENSOR_WIDTH_PX / camera.width_px
    z = np.where(z_m > 0.0, z_m, 1.0)
    axial = noise.axial_sigma_m(z, incidence_rad)
    lateral = noise.lateral_sigma_m(z, incidence_rad, focal_px)
    variance = np.zeros(z.shape)
    up = np.array([0.0, 0.0, 1.0])
    for (v, u), ray in _pixels(camera):
        # The axial sigma is one of z; the ray grows by |ray| for every metre of z.
        along = ray / np.linalg.norm(ray)
        across = np.eye(3) - np.outer(along, along)
        sigma_s = axial[v, u] ** 2 * np.outer(ray, ray) + lateral[v, u] ** 2 * across
        variance[v, u] = up @ rotation @ sigma_s @ rotation.T @ up
    return Measured(
        height_m=points[..., 2],
        variance_m2=variance,
        x_cells=(points[..., 0] + position[0]) / cell_size_m,
        y_cells=(points[..., 1] + position[1]) / cell_size_m,
        valid=z_m > 0.0,
    )


def _pixels(camera: CameraIntrinsics) -> list[tuple[tuple[int, int], Float64Array]]:
    r = rays(camera)
    return [((v, u), r[v, u]) for v in range(camera.height_px) for u in range(camera.width_px)]
