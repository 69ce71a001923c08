"""The plane of a flat floor in a depth image, in the optical frame.

A plane m . p = 1 is linear in inverse depth: 1/Z = m . (x, y, 1) with the ray (x, y, 1). The
floor is found by the consensus of random triples and fitted by least squares, each reading
weighted by the variance of its inverse depth, var(Z) / Z^4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration_rigs.errors import RigError
from drivers.samples import CameraIntrinsics
from mapping.noise import DepthNoiseModel

Float64Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_COLUMNS = 160  # of the thinned-out image
_TRIALS = 300
_INLIER_SIGMAS = 3.0
_LEAST_SHARE = 0.3
_FEWEST_READINGS = 200
# The readings' own noise is at most so much larger than the model's on a flat floor.
_FLAT_RATIO = 2.0


@dataclass(frozen=True, slots=True)
class Floor:
    """A floor as one image shows it.

    Attributes:
        plane: (3,) m with m . p = 1 on the floor, p in the optical frame, 1/m.
        misfit: root mean square of the residuals in units of the model's sigma; about 1 or less
            on a flat floor.
        readings: readings on the floor. share: of all valid ones.
        farthest_m: distance along the axis of the farthest of them.
    """

    plane: Float64Array
    misfit: float
    readings: int
    share: float
    farthest_m: float

    @property
    def height_m(self) -> float:
        """Distance of the camera from the floor."""
        return float(1.0 / np.linalg.norm(self.plane))

    @property
    def up(self) -> Float64Array:
        """Return the floor's upward normal (3,) in the optical frame."""
        return np.asarray(-self.plane / np.linalg.norm(self.plane))


def find_floor(
    depth_mm: NDArray[np.uint16],
    camera: CameraIntrinsics,
    noise: DepthNoiseModel,
    bias_sigmas: float = 0.0,
) -> Floor:
    """Return the floor in an image (height, width); `bias_sigmas` adds that much depth bias.

    Raises:
        RigError: too few readings, no plane among them, or one that is not flat.
    """
    rays, z_m = _readings(depth_mm, camera, noise)
    if len(z_m) < _FEWEST_READINGS:
        raise RigError(
            f"{len(z_m)} usable depth readings in an image; expected {_FEWEST_READINGS} or more: "
            "let the camera see the floor between its nearest and farthest range"
        )
    sigma = noise.axial_sigma_m(z_m, np.zeros_like(z_m)) / z_m**2
    inverse = 1.0 / (z_m + bias_sigmas * noise.bias_sigma_at_m(z_m))
    on_floor = _consensus(rays, inverse, sigma)
    for _ in range(3):
        plane = _fit(rays[on_floor], inverse[on_floor], sigma[on_floor])
        on_floor = np.abs(inverse - rays @ plane) <= _INLIER_SIGMAS * sigma
    residual = (inverse - rays @ plane)[on_floor] / sigma[on_floor]
    floor = Floor(
        plane,
        float(np.sqrt(np.mean(residual**2))),
        int(on_floor.sum()),
        float(on_floor.mean()),
        float(z_m[on_floor].max(initial=0.0)),
    )
    _require_floor(floor)
    return floor


def _readings(
    depth_mm: NDArray[np.uint16], camera: CameraIntrinsics, noise: DepthNoiseModel
) -> tuple[Float64Array, Float64Array]:
    """Return rays (n, 3) with third component 1, and corrected distances (n,), thinned out."""
    stride = max(camera.width_px // _COLUMNS, 1)
    some = depth_mm[::stride, ::stride]
    rows, columns = np.arange(some.shape[0]) * stride, np.arange(some.shape[1]) * stride
    u, v = np.meshgrid(columns, rows)
    measured = some / 1000.0
    bias = noise.bias_m + noise.bias_slope * measured + noise.bias_quadratic_per_m * measured**2
    z_m = measured - bias
    valid = (some > 0) & (z_m >= noise.range_min_m) & (z_m <= noise.range_max_m)
    x = (u[valid] - camera.cx_px) / camera.fx_px
    y = (v[valid] - camera.cy_px) / camera.fy_px
    return np.stack([x, y, np.ones_like(x)], axis=1), z_m[valid]


def _consensus(rays: Float64Array, inverse: Float64Array, sigma: Float64Array) -> BoolArray:
    """Return the readings on the plane that most agree with; the trials are always alike."""
    rng = np.random.default_rng(0)
    best = np.zeros(len(inverse), np.bool_)
    for triple in rng.integers(0, len(inverse), (_TRIALS, 3)):
        corner = rays[triple]
        if abs(np.linalg.det(corner)) < 1e-6:
            continue
        plane = np.linalg.solve(corner, inverse[triple])
        agreeing = np.abs(inverse - rays @ plane) <= _INLIER_SIGMAS * sigma
        if agreeing.sum() > best.sum():
            best = agreeing
    return best


def _fit(rays: Float64Array, inverse: Float64Array, sigma: Float64Array) -> Float64Array:
    solution = np.linalg.lstsq(rays / sigma[:, None], inverse / sigma, rcond=None)[0]
    return np.asarray(solution, np.float64)


def _require_floor(floor: Floor) -> None:
    if floor.share < _LEAST_SHARE:
        raise RigError(
            f"the largest plane holds {100.0 * floor.share:.0f} % of the readings; expected a flat "
            f"floor that fills {100.0 * _LEAST_SHARE:.0f} % of the image or more"
        )
    if floor.misfit > _FLAT_RATIO or floor.up[1] > -0.1:
        raise RigError(
            f"the largest plane faces {floor.up.round(2).tolist()} and its readings miss it by "
            f"{floor.misfit:.1f} of their sigma; expected a flat floor below the camera"
        )
