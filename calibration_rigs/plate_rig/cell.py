"""One cell: from its frames to what is said of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration_rigs.plate_rig.cell_result import CellResult
from calibration_rigs.plate_rig.correlation import correlation_area_px
from calibration_rigs.plate_rig.faults import Fault, shape_faults, view_faults
from calibration_rigs.plate_rig.frames import CellFrames
from calibration_rigs.plate_rig.manifest import CellEntry, Rig
from calibration_rigs.plate_rig.metrics import lateral_sigma_px, paper_numbers, temporal_spread
from calibration_rigs.plate_rig.outline import Outline, outline
from calibration_rigs.plate_rig.plane import DisparityPlane, pixels_of
from calibration_rigs.plate_rig.quantised import sheppard
from calibration_rigs.plate_rig.segmentation import Segment, find_plate, mean_depth_m
from calibration_rigs.plate_rig.spread import measure_spread
from mapping.measurement import SENSOR_WIDTH_PX

Float64Array = NDArray[np.float64]

_CORRELATION_FRAMES = 8


@dataclass(frozen=True, slots=True)
class CellOutcome:
    """A result, and what a map of the sensor's distortion is made of.

    Attributes:
        result: the numbers.
        residual_px: (height, width) float32 mean disparity minus the plane's, pixels of the
            640 px wide image; NaN off the plate.
    """

    result: CellResult
    residual_px: NDArray[np.float32]


def analyse(frames: CellFrames, cell: CellEntry, rig: Rig) -> CellOutcome:
    """Return what a cell's frames come to.

    Raises:
        RigError: there is no plate; the message does not name the cell.
    """
    camera = frames.camera
    disparity_px_m = rig.disparity_px_m(camera.fx_px, camera.width_px)
    mean_m, seen = mean_depth_m(frames.depth_mm)
    nominal_step_m = cell.distance_m**2 * rig.disparity_step_px / disparity_px_m
    plate = find_plate(mean_m, seen, cell, rig, nominal_step_m)
    found = outline(plate.whole, plate.plane, camera, rig)
    residual_px = _residual_px(plate, disparity_px_m)
    spread = measure_spread(frames.depth_mm, plate, found, camera, rig)
    plane = plate.plane.shifted(spread.fit.offset * rig.disparity_step_px / disparity_px_m)
    error_m, error_sigma_m, tape_faults = _tape_error(found, plate.plane, plane, cell, rig)
    decimation = SENSOR_WIDTH_PX / camera.width_px
    lateral, lateral_readings = lateral_sigma_px(frames.depth_mm, plate.plane, found)
    faults = view_faults(frames, found, plate, rig)
    faults += shape_faults(residual_px, plane, found, spread, cell, camera, rig)
    result = CellResult(
        cell=cell,
        device=frames.device,
        camera=camera,
        sha256=frames.sha256,
        frames=len(frames.depth_mm),
        pixels=int(np.count_nonzero(plate.eroded)),
        z_m=spread.z_m,
        incidence_rad=spread.incidence_rad,
        turn_rad=plane.turn_rad(camera),
        tip_rad=plane.tip_rad(camera),
        roll_rad=found.roll_rad,
        step_m=spread.step_m,
        spread=spread.fit,
        goodness=spread.goodness,
        plain_sigma_m=spread.plain * spread.step_m,
        sheppard_sigma_m=sheppard(spread.plain, 1.0) * spread.step_m,
        error_m=error_m,
        error_sigma_m=float(np.hypot(error_sigma_m, spread.fit.offset_sigma * spread.step_m)),
        fill_rate=float(seen[plate.inside].mean()),
        z_accuracy=None if error_m is None else error_m / (found.middle_m[2] - error_m),
        subpixel_rms_px=spread.plain * rig.disparity_step_px,
        temporal=temporal_spread(frames.depth_mm, plate.eroded),
        lateral_px=lateral * decimation,
        lateral_readings=lateral_readings,
        correlation_area_px=_correlation(frames, plate, disparity_px_m) * decimation**2,
        paper=paper_numbers(frames.depth_mm, plate.eroded, plate.plane),
        deviations=spread.deviations,
        faults=(*faults, *tape_faults),
    )
    return CellOutcome(result, residual_px)


def _tape_error(
    found: Outline,
    fitted: DisparityPlane,
    corrected: DisparityPlane,
    cell: CellEntry,
    rig: Rig,
) -> tuple[float | None, float, list[Fault]]:
    """Return reading minus tape, its sigma, and what is wrong with the tape.

    The plate's middle is half way between its top right and bottom left corner, so the mean of
    their errors is free of angle and size of the plate; the top left corner tells which of the
    two is wrong when they disagree.

    Args:
        found: the outline, in terms of the `fitted` plane.
        fitted: through the mean readings.
        corrected: the same without the bias that steps cause.
        cell, rig: tape and plate.
    """
    middle_z = found.middle_m[2]
    shift = middle_z**2 * (fitted.c - corrected.c)  # d Z = - Z^2 d(1/Z)
    if cell.corners_m is None:
        error = middle_z + shift - cell.distance_m
        return error, float(np.hypot(rig.tape_sigma_m, found.middle_z_sigma_m)), []
    errors = np.array(found.corners_z_m) + shift - np.array(cell.corners_m)
    tolerance = 0.05 + 4.0 * found.middle_z_sigma_m + 0.1 * abs(np.diff(found.corners_z_m)).max()
    off = errors - np.median(errors)
    worst = int(np.argmax(np.abs(off)))
    if abs(off[worst]) > tolerance:
        return None, 0.0, [Fault.tape(worst, cell.corners_m[worst], float(off[worst]))]
    error = 0.5 * float(errors[1] + errors[2])
    sigma = float(np.hypot(rig.tape_sigma_m / np.sqrt(2.0), found.middle_z_sigma_m))
    return error, sigma, []


def _residual_px(plate: Segment, disparity_px_m: float) -> NDArray[np.float32]:
    """Return the mean disparity minus the plane's, see `CellOutcome`."""
    u, v = pixels_of(plate.eroded)
    residual = np.full(plate.eroded.shape, np.nan, np.float32)
    inverse = plate.plane.inverse_z(u, v)
    residual[plate.eroded] = disparity_px_m * (1.0 / plate.mean_m[plate.eroded] - inverse)
    return residual


def _correlation(frames: CellFrames, plate: Segment, disparity_px_m: float) -> float:
    """Return the correlation area in pixels of the image."""
    some = frames.depth_mm[:: max(1, len(frames.depth_mm) // _CORRELATION_FRAMES)]
    rows = np.flatnonzero(plate.eroded.any(axis=1))
    columns = np.flatnonzero(plate.eroded.any(axis=0))
    box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    v, u = np.mgrid[box].astype(np.float64)
    inverse = plate.plane.inverse_z(u, v).astype(np.float32)
    z_m = np.float32(1e-3) * some[(slice(None), *box)]
    there = (z_m > 0.0) & plate.eroded[box]
    residual = np.where(there, disparity_px_m * (1.0 / np.where(there, z_m, 1.0) - inverse), np.nan)
    return correlation_area_px(residual)
