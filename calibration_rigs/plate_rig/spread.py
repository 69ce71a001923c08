"""The spread of one cell's readings about its plane, where distance and angle hardly change."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians

import numpy as np
from numpy.typing import NDArray

from calibration_rigs.plate_rig.goodness import Goodness, goodness_of_fit
from calibration_rigs.plate_rig.manifest import Rig
from calibration_rigs.plate_rig.outline import Outline
from calibration_rigs.plate_rig.plane import DisparityPlane, pixels_of
from calibration_rigs.plate_rig.quantised import (
    QuantisedSpread,
    count_readings,
    fit_spread,
)
from calibration_rigs.plate_rig.segmentation import Segment
from calibration_rigs.plate_rig.step_law import expected_shares
from drivers.samples import CameraIntrinsics

Float64Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

# A steep plate spans distances and angles; sigma is that around its middle.
_DISTANCE_SHARE = 0.04
_ANGLE_RAD = radians(2.0)
_FACING_RAD = radians(12.0)
_PIXELS_AT_MOST = 10_000
_PATCH_PX = 12
_PATCHES_A_SIDE = 6
# Two pieces hardly tell their own spread: t has one degree of freedom.
_PATCHES_AT_LEAST = 3
# More tell no better where two steps lie.
_COMB_READINGS = 200_000
# Below this share of its length the mean of unit vectors says nothing about their direction.
_COMB_VISIBLE = 0.1
_SPACINGS_PX = (8, 4, 2, 1)
_READINGS_FOR_CHI2 = 200
_ROUNDING_M = 1e-3


@dataclass(frozen=True, slots=True)
class Deviations:
    """Readings about the plane: what was found and what a quantised normal law expects.

    Attributes:
        edges_m: (bins + 1,) of the deviations, metres.
        found, expected: (bins,) readings.
    """

    edges_m: Float64Array
    found: Float64Array
    expected: Float64Array


@dataclass(frozen=True, slots=True)
class Spread:
    """What `measure_spread` finds.

    Attributes:
        z_m, incidence_rad: mean of the readings used.
        step_m: depth step there.
        fit: sigma and its interval, steps.
        plain: standard deviation of the readings, steps.
        goodness: see `CellResult`.
        deviations: histogram.
    """

    z_m: float
    incidence_rad: float
    step_m: float
    fit: QuantisedSpread
    plain: float
    goodness: Goodness | None
    deviations: Deviations


def measure_spread(
    depth_mm: NDArray[np.uint16],
    plate: Segment,
    found: Outline,
    camera: CameraIntrinsics,
    rig: Rig,
) -> Spread:
    """Return the spread of the readings around the middle of the plate.

    Args:
        depth_mm: (frames, height, width); 0 = no return.
        plate, found: the plate in the image.
        camera, rig: sensor.
    """
    step = rig.disparity_step_px / rig.disparity_px_m(camera.fx_px, camera.width_px)
    u, v = _middle_pixels(plate, found, camera)
    inverse = plate.plane.inverse_z(u, v)
    z_m = float(np.mean(1.0 / inverse))
    readings_mm = depth_mm[:, v.astype(np.intp), u.astype(np.intp)].astype(np.float64)
    readings_mm[readings_mm == 0.0] = np.nan
    # Whole millimetres would beat with the bins of the table; spread them over their millimetre.
    readings_mm += np.random.default_rng(1).uniform(-0.5, 0.5, readings_mm.shape)
    readings = 1e3 / readings_mm / step
    predicted = inverse / step
    comb = _comb_offset(readings)
    step_m = z_m**2 * step
    rounding = _ROUNDING_M * np.sqrt(2.0 / 12.0) / step_m  # to millimetres, and over them again
    table = count_readings(predicted - comb, readings - comb, patches_of(u, v), rounding)
    fit = fit_spread(table)
    parameters = np.array([fit.offset, np.log(fit.before), np.log(fit.behind)])
    shares = expected_shares(parameters, table.phases, table.edges)
    total = table.counts.sum(axis=0)
    deviations = Deviations(
        edges_m=-table.edges[::-1] * step_m,  # more disparity is less distance
        found=total.sum(axis=0)[::-1].astype(np.float64),
        expected=(total.sum(axis=1) @ shares)[::-1],
    )
    some = _apart(u, v)
    frame = np.arange(some.size) * 7919 % len(depth_mm)
    return Spread(
        z_m=z_m,
        incidence_rad=float(np.mean(plate.plane.incidence_rad(u, v, camera))),
        step_m=step_m,
        fit=fit,
        plain=float(np.nanstd(readings - predicted)),
        goodness=goodness_of_fit(fit, predicted[some] - comb, readings[frame, some] - comb),
        deviations=deviations,
    )


def _middle_pixels(
    plate: Segment, found: Outline, camera: CameraIntrinsics
) -> tuple[Float64Array, Float64Array]:
    """Return the pixels whose distance and incidence are nearly those of the plate's middle."""
    u, v = pixels_of(plate.eroded)
    inverse = plate.plane.inverse_z(u, v)
    incidence = plate.plane.incidence_rad(u, v, camera)
    x, y, z = found.middle_m
    middle = _within(plate.plane, camera, x / z, y / z, u, v)
    alike = np.abs(incidence - middle) < _ANGLE_RAD
    alike |= (incidence < _FACING_RAD) & (middle < _FACING_RAD)
    near = np.abs(1.0 / (inverse * z) - 1.0) < _DISTANCE_SHARE
    chosen = alike & near
    if np.count_nonzero(chosen) < 100:  # the middle is out of sight: the middle of what is seen
        inner = np.median(1.0 / inverse)
        chosen = np.abs(1.0 / (inverse * inner) - 1.0) < _DISTANCE_SHARE
    every = max(1, int(np.ceil(np.count_nonzero(chosen) / _PIXELS_AT_MOST)))
    return u[chosen][::every], v[chosen][::every]


def _within(
    plane: DisparityPlane,
    camera: CameraIntrinsics,
    x: float,
    y: float,
    u: Float64Array,
    v: Float64Array,
) -> float:
    """Return the incidence at the middle, or at the nearest pixel that is on the plate."""
    u_mid = np.clip(x * camera.fx_px + camera.cx_px, u.min(), u.max())
    v_mid = np.clip(y * camera.fy_px + camera.cy_px, v.min(), v.max())
    return float(plane.incidence_rad(np.array(u_mid), np.array(v_mid), camera))


def _comb_offset(readings: Float64Array) -> float:
    """Return where the sensor's steps lie between whole numbers of steps, or 0 if nobody can tell.

    The product of focal length and baseline is never known well enough to tell the steps'
    places; the readings themselves do, unless they are smeared.
    """
    some = readings.ravel()[:: max(1, readings.size // _COMB_READINGS)]
    mean = np.mean(np.exp(2j * np.pi * some[np.isfinite(some)]))
    return float(np.angle(mean) / (2.0 * np.pi)) if np.abs(mean) > _COMB_VISIBLE else 0.0


def patches_of(u: Float64Array, v: Float64Array) -> IntArray:
    """Return the patch of each pixel: rows of equal size, cut into pieces of equal size."""
    rows = int(np.clip(np.ptp(v) // _PATCH_PX, _PATCHES_AT_LEAST, 2 * _PATCHES_A_SIDE))
    columns = int(np.clip(np.ptp(u) // _PATCH_PX, 1, _PATCHES_A_SIDE))
    rows = min(rows, max(_PATCHES_A_SIDE, 36 // columns))
    row = np.argsort(np.argsort(v, kind="stable"), kind="stable") * rows // v.size
    patch = np.empty(u.size, np.int64)
    for r in range(rows):
        inside = np.flatnonzero(row == r)
        rank = np.argsort(np.argsort(u[inside], kind="stable"), kind="stable")
        patch[inside] = r * columns + rank * columns // inside.size
    return patch


def _apart(u: Float64Array, v: Float64Array) -> IntArray:
    """Return pixels as far apart as leaves enough of them for a chi-square."""
    chosen = np.zeros(0, np.int64)
    for spacing in _SPACINGS_PX:
        chosen = np.flatnonzero((u % spacing == 0) & (v % spacing == 0))
        if chosen.size >= _READINGS_FOR_CHI2:
            break
    return chosen
