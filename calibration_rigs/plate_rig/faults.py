"""What can be wrong with a cell, in plain words."""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees, hypot

import numpy as np
from numpy.typing import NDArray

from calibration_rigs.plate_rig.frames import CellFrames
from calibration_rigs.plate_rig.manifest import CORNERS, CellEntry, Rig
from calibration_rigs.plate_rig.outline import Outline
from calibration_rigs.plate_rig.plane import DisparityPlane
from calibration_rigs.plate_rig.segmentation import Segment
from calibration_rigs.plate_rig.spread import Spread
from drivers.samples import CameraIntrinsics

FRAMES_WANTED = 100
FRAMES_AT_LEAST = 10
_ANGLE_TOLERANCE_DEG = 2.0
_ROLL_TOLERANCE_DEG = 1.0
_SIZE_SHARE = 0.85
_BEND_M = 0.006
# Steps that no noise smears beat with the pixels of a steep plate and look like a bend.
_BEND_STEPS = 0.3
_BEND_STEPS_QUIET = 0.6


@dataclass(frozen=True, slots=True)
class Fault:
    """Something wrong with a cell.

    Attributes:
        kind: in one word, for programs.
        text: what was found, what was expected, what to do.
        excludes: the cell takes no part in the fits.
    """

    kind: str
    text: str
    excludes: bool

    @classmethod
    def tape(cls, corner: int, tape_m: float, off_m: float) -> Fault:
        """Say which corner's tape disagrees with the other two."""
        text = (
            f"the tape to the {CORNERS[corner]} corner says {tape_m:.3f} m, the plate and the "
            f"other two say {tape_m + off_m:.3f} m; measure again, or correct the number"
        )
        return cls("tape", text, excludes=True)


def view_faults(frames: CellFrames, found: Outline, plate: Segment, rig: Rig) -> list[Fault]:
    """Return what is wrong with what the camera saw: too little of it, or too few frames."""
    faults = []
    count = len(frames.depth_mm)
    if count < FRAMES_WANTED:
        faults.append(
            Fault(
                "frames",
                f"{count} frames, expected at least {FRAMES_WANTED}; "
                + ("the cell is not used" if count < FRAMES_AT_LEAST else "its sigma is less sure"),
                excludes=count < FRAMES_AT_LEAST,
            )
        )
    fits_m = frames.camera.width_px / frames.camera.fx_px * found.middle_m[2]
    sides = [side for side in found.cut_sides if side in ("left", "right")]
    if sides and found.width_m < _SIZE_SHARE * min(rig.plate_width_m, fits_m):
        faults.append(
            Fault(
                "view",
                f"the plate is cut off at the {' and '.join(sides)} border of the image, "
                f"{found.width_m:.2f} m of {rig.plate_width_m:.2f} m are seen; turn the camera",
                excludes=True,
            )
        )
    elif found.left.is_seen and found.right.is_seen:
        faults += _size_fault(found, rig)
    if plate.eroded.sum() < 1000:
        text = f"only {plate.eroded.sum()} pixels are well on the plate; its sigma is less sure"
        faults.append(Fault("pixels", text, excludes=False))
    return faults


def _size_fault(found: Outline, rig: Rig) -> list[Fault]:
    """Return what is wrong with the size of a plate whose sides are both seen."""
    whole = found.top.is_seen and found.bottom.is_seen
    short = found.width_m < _SIZE_SHARE * rig.plate_width_m
    low = whole and found.height_m < _SIZE_SHARE * rig.plate_height_m
    if not (short or low):
        return []
    text = (
        f"the plate is {found.width_m:.2f} m wide and {found.height_m:.2f} m high, expected "
        f"{rig.plate_width_m:.2f} m x {rig.plate_height_m:.2f} m; is it the plate, and does "
        "nothing stand in front of it?"
    )
    return [Fault("size", text, excludes=True)]


def shape_faults(
    residual_px: NDArray[np.float32],
    plane: DisparityPlane,
    found: Outline,
    spread: Spread,
    cell: CellEntry,
    camera: CameraIntrinsics,
    rig: Rig,
) -> list[Fault]:
    """Return what is wrong with the plate itself: bent, or not turned as it should be.

    Args:
        residual_px: (height, width) mean disparity minus the plane's; NaN off the plate.
        plane, found, spread: of the plate.
        cell: what was asked for.
        camera, rig: sensor.
    """
    faults = []
    bend_m = _bend(residual_px) * found.middle_m[2] ** 2
    bend_m /= rig.disparity_px_m(camera.fx_px, camera.width_px)
    steps = _BEND_STEPS_QUIET if spread.fit.is_below else _BEND_STEPS
    limit_m = max(_BEND_M, steps * spread.step_m)
    if bend_m > limit_m:
        text = (
            f"the plate is bent: {1000 * bend_m:.0f} mm between its middle and its rim, expected "
            f"less than {1000 * limit_m:.0f} mm; stiffen it"
        )
        faults.append(Fault("bent", text, excludes=True))
    turn_deg = abs(degrees(plane.turn_rad(camera)))
    if abs(turn_deg - abs(cell.angle_deg)) > _ANGLE_TOLERANCE_DEG:
        text = (
            f"the plate is turned by {turn_deg:.1f} deg, the tripod says "
            f"{abs(cell.angle_deg):.1f} deg; the measured angle is used"
        )
        faults.append(Fault("angle", text, excludes=False))
    tip_deg, roll_deg = degrees(plane.tip_rad(camera)), degrees(found.roll_rad)
    if hypot(tip_deg, roll_deg) > _ROLL_TOLERANCE_DEG:
        text = (
            f"the plate is tilted: it leans by {tip_deg:.1f} deg and its sides are {roll_deg:.1f} "
            f"deg off the vertical, expected less than {_ROLL_TOLERANCE_DEG:g} deg; level "
            "camera and tripod"
        )
        faults.append(Fault("tilted", text, excludes=False))
    return faults


def _bend(residual_px: NDArray[np.float32]) -> float:
    """Return how far the middle stands off the rim, pixels of disparity: a quadratic surface."""
    v, u = np.nonzero(np.isfinite(residual_px))
    some = slice(None, None, max(1, v.size // 5000))
    v, u = v[some], u[some]
    x = 2.0 * (u - u.min()) / max(np.ptp(u), 1) - 1.0
    y = 2.0 * (v - v.min()) / max(np.ptp(v), 1) - 1.0
    columns = np.column_stack([np.ones_like(x), x, y, x * y, x * x, y * y])
    fit = np.linalg.lstsq(columns, residual_px[v, u].astype(np.float64), rcond=None)[0]
    return float(np.abs(fit[3:]).sum())
