"""A plane in disparity: 1/Z = a u + b v + c, and what it says about the plate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.samples import CameraIntrinsics

Float64Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class DisparityPlane:
    """1/Z = a u + b v + c, with u, v in pixels of the image and Z in metres along the axis.

    Any plane in space is a plane in (u, v, 1/Z); noise of a disparity sensor is even there.
    """

    a: float
    b: float
    c: float

    def inverse_z(self, u: Float64Array, v: Float64Array) -> Float64Array:
        """Return 1/Z in 1/m at pixels."""
        return self.a * u + self.b * v + self.c

    def z_m(self, u: float, v: float) -> float:
        """Return the distance along the axis at one pixel, metres."""
        return 1.0 / (self.a * u + self.b * v + self.c)

    def shifted(self, by: float) -> DisparityPlane:
        """Return the plane with `by` (1/m) added to 1/Z."""
        return DisparityPlane(self.a, self.b, self.c + by)

    def normal(self, camera: CameraIntrinsics) -> Float64Array:
        """Return (A, B, C) with A X + B Y + C Z = 1 in the optical frame, 1/m."""
        return np.array(
            [
                self.a * camera.fx_px,
                self.b * camera.fy_px,
                self.c + self.a * camera.cx_px + self.b * camera.cy_px,
            ]
        )

    def turn_rad(self, camera: CameraIntrinsics) -> float:
        """Return how far the plate is turned about the vertical; 0 = facing the camera."""
        normal = self.normal(camera)
        return float(np.arctan2(normal[0], normal[2]))

    def tip_rad(self, camera: CameraIntrinsics) -> float:
        """Return how far the plate leans forward or back."""
        normal = self.normal(camera)
        return float(np.arcsin(normal[1] / np.linalg.norm(normal)))

    def incidence_rad(
        self, u: Float64Array, v: Float64Array, camera: CameraIntrinsics
    ) -> Float64Array:
        """Return the angle between each pixel's ray and the plate's normal."""
        x, y = (u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px
        length = np.linalg.norm(self.normal(camera)) * np.sqrt(1.0 + x * x + y * y)
        cosine: Float64Array = np.clip(self.inverse_z(u, v) / length, -1.0, 1.0)
        return np.arccos(cosine)


def fit_plane(
    u: Float64Array, v: Float64Array, z_m: Float64Array, weight: Float64Array | None = None
) -> DisparityPlane:
    """Return the plane of least squares through pixels.

    A disparity's noise is the same everywhere on a plate, so residuals of 1/Z count alike; in
    terms of Z that is the weight Z^2 of the residual Z^2 d(1/Z) ~ dZ taken back.

    Args:
        u, v: (n,) pixels.
        z_m: (n,) mean distances, > 0.
        weight: (n,) how much each counts; None = alike.
    """
    root = np.ones_like(z_m) if weight is None else np.sqrt(weight)
    columns = np.column_stack([u, v, np.ones_like(u)]) * root[:, np.newaxis]
    solution = np.linalg.lstsq(columns, root / z_m, rcond=None)[0]
    return DisparityPlane(*map(float, solution))


def pixels_of(mask: BoolArray) -> tuple[Float64Array, Float64Array]:
    """Return u and v of the pixels of a mask, row by row."""
    v, u = np.nonzero(mask)
    return u.astype(np.float64), v.astype(np.float64)
