"""How much a depth reading can be wrong: axial, lateral and systematic parts.

One parametric form covers every model that terravibe knows (z = distance along the optical axis
in metres, t = theta / (pi/2 - theta), theta = angle between the viewing ray and the surface
normal):

    sigma_z(z, theta)^2 = (c0 + c1 (z - c2)^2 + c3 / sqrt(z) t^2)^2 + (k z^2)^2 / 12
    sigma_L(z, theta)   = (l0 + l1 t) z / f
    bias(z)             = b0 + b1 z + b2 z^2, known to +- (s0 + s2 z^2)

c0..c3, l0, l1 with the values of `NGUYEN_2012`: Nguyen, Izadi, Lovell, "Modeling Kinect Sensor
Noise for Improved 3D Reconstruction and Tracking", 3DIMPVT 2012. k z^2 is the depth step of a
disparity sensor that counts in 1/8 pixel: k = 1 / (8 f b). Nguyen's spread was measured on real,
quantised readings and therefore contains the step; models fitted to the underlying noise do not,
and set k.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mapping.errors import MappingError

Float64Array = NDArray[np.float64]

# Beyond this angle Nguyen's fit has no data; its pole at 90 degrees must not be reached.
INCIDENCE_LIMIT_RAD = float(np.radians(84.0))


@dataclass(frozen=True, slots=True)
class DepthNoiseModel:
    """Coefficients of the form above.

    Attributes:
        name: how the model is called in reports.
        axial_offset_m, axial_quadratic_per_m, axial_reference_m: c0, c1, c2.
        axial_angle_m_sqrt_m: c3, in m * sqrt(m).
        lateral_offset_px, lateral_angle_px: l0, l1, in pixels of the sensor's 640 px wide image;
            a narrower image is taken as decimated from it.
        quantum_per_m: k; the depth step at distance z is k z^2 metres; 0 = already in c0..c3.
        bias_m, bias_slope, bias_quadratic_per_m: b0, b1, b2; subtracted from every reading.
        bias_sigma_m, bias_sigma_quadratic_per_m: s0, s2; one draw per device and run.
        correlation_area_px: pixels of the 640 px wide image that share one noise draw: the
            autocorrelation summed over all lags; see `independent_readings`; 1 = white noise.
        fixed_share: share of a reading's variance that is the same in all frames from one place;
            by default what the depth step, (k z^2)^2 / 12, is of Nguyen's spread at 1.5-4 m.
        range_min_m, range_max_m: readings outside are not mapped.
    """

    name: str
    axial_offset_m: float
    axial_quadratic_per_m: float = 0.0
    axial_reference_m: float = 0.0
    axial_angle_m_sqrt_m: float = 0.0
    lateral_offset_px: float = 0.0
    lateral_angle_px: float = 0.0
    quantum_per_m: float = 0.0
    bias_m: float = 0.0
    bias_slope: float = 0.0
    bias_quadratic_per_m: float = 0.0
    bias_sigma_m: float = 0.0
    bias_sigma_quadratic_per_m: float = 0.0
    correlation_area_px: float = 1.0
    fixed_share: float = 0.3
    range_min_m: float = 0.4
    range_max_m: float = 4.0

    def axial_sigma_m(self, z_m: Float64Array, incidence_rad: Float64Array) -> Float64Array:
        """Return sigma_z in metres for distances and incidence angles of equal shape."""
        t = _angle_ratio(incidence_rad)
        spread = (
            self.axial_offset_m
            + self.axial_quadratic_per_m * (z_m - self.axial_reference_m) ** 2
            + self.axial_angle_m_sqrt_m / np.sqrt(z_m) * t**2
        )
        return np.sqrt(spread**2 + (self.quantum_per_m * z_m**2) ** 2 / 12.0)

    def lateral_sigma_m(
        self, z_m: Float64Array, incidence_rad: Float64Array, focal_px: float
    ) -> Float64Array:
        """Return sigma_L in metres, perpendicular to the ray.

        `focal_px` is the focal length of the sensor's 640 px wide image.
        """
        sigma_px = self.lateral_offset_px + self.lateral_angle_px * _angle_ratio(incidence_rad)
        return sigma_px * z_m / focal_px

    def bias_sigma_at_m(self, z_m: Float64Array) -> Float64Array:
        """Return the standard deviation in metres of the depth bias that is left."""
        return self.bias_sigma_m + self.bias_sigma_quadratic_per_m * z_m**2

    def with_range(self, range_min_m: float, range_max_m: float) -> DepthNoiseModel:
        """Return the same model for readings between these distances."""
        return replace(self, range_min_m=range_min_m, range_max_m=range_max_m)


def independent_readings(pixels: Float64Array, area_px: float) -> Float64Array:
    """Return N_eff of `pixels` neighbours whose noise is alike over `area_px` pixels (>= 1).

    The variance of their mean is that of one over N_eff = n^2 / (sum of rho over all pairs). Only
    pairs inside the patch count: `area_px`, the sum of rho over all lags, counts neighbours that
    lie outside, so n / area_px is too few, half at n = area_px, and below one for less. With
    rho = exp(-pi r^2 / A), a compact patch and x = (n - 1) / A

        N_eff = 1 + x + (1 - 1/A) (2/pi) x sqrt(x) / (x + sqrt(2 x) + 0.6)

    1 for one pixel, n for white noise (A = 1), (sqrt(x) + 1/pi)^2 for large patches, as the
    integral has it. Within 4 % of the sum over pairs for squares; patches three times as long as
    wide are worth up to 12 % more than this says, which errs on the safe side.
    """
    x = (pixels - 1.0) / area_px
    root = np.sqrt(x)
    inside = x * root / (x + np.sqrt(2.0) * root + 0.6)
    count: Float64Array = 1.0 + x + (1.0 - 1.0 / area_px) * (2.0 / np.pi) * inside
    return count


def _angle_ratio(incidence_rad: Float64Array) -> Float64Array:
    """Return theta / (pi/2 - theta), held at its value at the incidence limit."""
    theta = np.minimum(incidence_rad, INCIDENCE_LIMIT_RAD)
    return theta / (np.pi / 2.0 - theta)


# Nguyen et al. give spreads only; as published: no bias, every pixel for itself.
NGUYEN_2012 = DepthNoiseModel(
    name="nguyen2012",
    axial_offset_m=0.0012,
    axial_quadratic_per_m=0.0019,
    axial_reference_m=0.4,
    axial_angle_m_sqrt_m=0.0001,
    lateral_offset_px=0.8,
    lateral_angle_px=0.035,
)

# 16 bits of millimetres.
_LARGEST_READING_M = 65.535

# f b of a Kinect V1: 580 px x 75 mm.
KINECT_V1_FOCAL_BASELINE_PX_M = 43.5

# An uncalibrated structured-light sensor: Nguyen's spread, a bias of 0.05 px of disparity
# (0.05 z^2 / (f b)), and noise that is alike over about 42 pixels: the sum of the autocorrelation
# of plane-fit residuals in disparity on real frames (1108 patches of 48 x 48 px, 0.8-3 m).
KINECT_V1 = replace(
    NGUYEN_2012,
    name="kinect-v1",
    bias_sigma_quadratic_per_m=0.05 / KINECT_V1_FOCAL_BASELINE_PX_M,
    correlation_area_px=42.0,
)

# The depth step alone: what is left of a Kinect V1 whose other noise is far below it.
KINECT_QUANTISATION = DepthNoiseModel(
    name="kinect-quantisation",
    axial_offset_m=0.0,
    quantum_per_m=1.0 / (8.0 * KINECT_V1_FOCAL_BASELINE_PX_M),
    fixed_share=1.0,
)

PRESETS = {model.name: model for model in (KINECT_V1, NGUYEN_2012, KINECT_QUANTISATION)}


def constant_noise(sigma_m: float) -> DepthNoiseModel:
    """Return a model with the same axial sigma everywhere and no lateral noise.

    Raises:
        MappingError: sigma is not a positive number, or larger than any depth reading.
    """
    if not 0.0 < sigma_m <= _LARGEST_READING_M:
        raise MappingError(
            f"constant depth noise is {sigma_m} m; expected a number above 0, at most "
            f"{_LARGEST_READING_M} m"
        )
    return DepthNoiseModel(name="constant", axial_offset_m=sigma_m)
