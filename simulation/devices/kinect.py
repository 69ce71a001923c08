"""What a Kinect V1 makes of clean depth: disparity noise and steps, shadow, drop-outs, range."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.samples import CameraIntrinsics
from simulation.errors import SimulationError

Float64Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

# Nguyen's angle term has its pole at 90 degrees; beyond this angle it stays as it is.
_STEEPEST_RAD = float(np.radians(84.0))


def kinect_320() -> CameraIntrinsics:
    """Return a Kinect V1 decimated to 320 x 240: 57 x 43 degrees."""
    return CameraIntrinsics(320, 240, 290.0, 290.0, 159.5, 119.5)


def kinect_640() -> CameraIntrinsics:
    """Return a Kinect V1 at its own 640 x 480."""
    return CameraIntrinsics(640, 480, 580.0, 580.0, 319.5, 239.5)


@dataclass(frozen=True, slots=True)
class CleanView:
    """What a perfect range camera sees: (height, width) arrays.

    Attributes:
        z_m: distance along the optical axis; 0 = nothing.
        cos_incidence: cosine between the ray and the surface's normal, 0 to 1.
        cos_sun: cosine between the direction to the sun and the normal; 0 = turned away.
    """

    z_m: Float64Array
    cos_incidence: Float64Array
    cos_sun: Float64Array


@dataclass(frozen=True, slots=True)
class KinectModel:
    """Errors of the sensor; disparities d in pixels of the 640-pixel image, d = 43.5 px m / z.

    With the defaults sigma(z) follows Nguyen, Izadi and Lovell 2012 to 45 degrees of incidence.

    Attributes:
        disparity_px_m: focal length times baseline, 580 px times 75 mm.
        baseline_m: the projector stands this far along the optical frame's x.
        sigma_disparity_px: noise of the disparity.
        disparity_step_px: it is rounded to multiples of this.
        disparity_bias_px: constant error of the disparity.
        floor_sigma_m: noise that does not depend on the distance.
        range_min_m, range_max_m: readings outside are dropped.
        grazing_rad: incidence from which readings begin to drop out, and where all have.
        sunlight: irradiance of the sun over that of the pattern, both at right angles, at 1 m;
            0 = indoors or at night. Where the two are equal half of the readings drop out. What
            turns away from the sun is dark, but nothing casts a shadow of the sun.
    """

    disparity_px_m: float = 43.5
    baseline_m: float = 0.075
    sigma_disparity_px: float = 0.056
    disparity_step_px: float = 0.125
    disparity_bias_px: float = 0.0
    floor_sigma_m: float = 0.001
    range_min_m: float = 0.8
    range_max_m: float = 4.0
    grazing_rad: tuple[float, float] = (float(np.radians(82.0)), float(np.radians(89.0)))
    sunlight: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what no sensor is."""
        positive = (self.disparity_px_m, self.disparity_step_px, self.range_min_m)
        not_negative = (self.sigma_disparity_px, self.floor_sigma_m, self.sunlight)
        if not (
            all(value > 0.0 for value in positive)
            and all(value >= 0.0 for value in not_negative)
            and self.range_min_m < self.range_max_m <= 65.0
            and self.grazing_rad[0] < self.grazing_rad[1]
        ):
            raise SimulationError(
                f"{self}: expected positive disparity, step and range, a range up to 65 m, "
                "grazing angles that increase, and noise and sunlight of 0 or more"
            )


def lit_by_projector(view: CleanView, camera: CameraIntrinsics, model: KinectModel) -> BoolArray:
    """Return the pixels whose surface the projector lights.

    The projector stands beside the camera, in the plane of each image row. What stands between it
    and a point is therefore in the same row, to the right, and nearer to the row's left end as
    seen from the projector. Only what the camera itself sees can cast a shadow.
    """
    seen = view.z_m > 0.0
    ray_x = (np.arange(camera.width_px, dtype=np.float64) - camera.cx_px) / camera.fx_px
    from_projector = np.where(
        seen, ray_x - model.baseline_m / np.where(seen, view.z_m, 1.0), np.inf
    )
    leftmost = np.minimum.accumulate(from_projector[:, ::-1], axis=1)[:, ::-1]
    return np.asarray(seen & (from_projector <= leftmost))


def in_range(z_m: Float64Array, model: KinectModel) -> BoolArray:
    """Return the pixels between the least and the greatest distance."""
    return np.asarray((z_m >= model.range_min_m) & (z_m <= model.range_max_m))


def kinect_depth_mm(
    view: CleanView, camera: CameraIntrinsics, model: KinectModel, random: np.random.Generator
) -> NDArray[np.uint16]:
    """Return the (height, width) image in millimetres that the sensor would give; 0 = none."""
    chance = random.random(view.z_m.shape)
    kept = lit_by_projector(view, camera, model) & (chance >= drop_out_probability(view, model))
    z_m = _with_noise(view, model, random)
    depth_mm = np.rint(z_m * 1000.0)
    return np.where(kept & in_range(z_m, model), depth_mm, 0.0).astype(np.uint16)


def drop_out_probability(view: CleanView, model: KinectModel) -> Float64Array:
    """Return the probability that a lit pixel gives no reading: grazing view, sunlight."""
    begin, end = model.grazing_rad
    grazing = np.clip((np.arccos(view.cos_incidence) - begin) / (end - begin), 0.0, 1.0)
    # The pattern's irradiance falls with the square of the distance, the sun's does not.
    pattern = np.maximum(view.cos_incidence, 1e-3)
    ratio = model.sunlight * view.cos_sun * view.z_m**2 / pattern
    drowned = ratio**2 / (1.0 + ratio**2)
    return np.asarray(1.0 - (1.0 - grazing) * (1.0 - drowned), np.float64)


def _with_noise(view: CleanView, model: KinectModel, random: np.random.Generator) -> Float64Array:
    """Return distances from noisy, rounded disparities, with the floor and the angle term."""
    z_m = np.where(view.z_m > 0.0, view.z_m, 1.0)
    disparity = model.disparity_px_m / z_m + model.disparity_bias_px
    disparity += model.sigma_disparity_px * random.standard_normal(z_m.shape)
    steps = np.maximum(np.rint(disparity / model.disparity_step_px), 1.0)
    theta = np.minimum(np.arccos(view.cos_incidence), _STEEPEST_RAD)
    sigma = model.floor_sigma_m + 1e-4 / np.sqrt(z_m) * (theta / (np.pi / 2.0 - theta)) ** 2
    sensed = model.disparity_px_m / (steps * model.disparity_step_px)
    return np.asarray(sensed + sigma * random.standard_normal(z_m.shape), np.float64)
