"""What is doubtful about a cell while the operator still stands at the plate."""

from __future__ import annotations

from math import radians, sin
from pathlib import Path

from calibration_rigs.plate_rig.cell import analyse
from calibration_rigs.plate_rig.frames import read_frames
from calibration_rigs.plate_rig.manifest import CellEntry, Rig
from calibration_rigs.plate_rig.session_state import Target

_TAPE_TOLERANCE_M = 0.1


def look_at(path: Path, cell: CellEntry, rig: Rig) -> list[str]:
    """Return what is wrong with the recording of a cell.

    Raises:
        RigError: there is no plate.
        StreamError: it cannot be read.
    """
    result = analyse(read_frames(path, rig), cell, rig).result
    return [fault.text for fault in result.faults]


def tape_doubt(corners_m: tuple[float, float, float], target: Target, rig: Rig) -> str:
    """Return what is doubtful about the tape of a cell, or "" when it may be right."""
    half = 0.5 * rig.plate_width_m * abs(sin(radians(target.angle_deg)))
    top_left, top_right, bottom_left = corners_m
    if abs(top_left - bottom_left) > _TAPE_TOLERANCE_M:
        return (
            f"Both left corners should be equally far, the tape says {top_left:.3f} and "
            f"{bottom_left:.3f} m."
        )
    middle = 0.5 * (top_right + bottom_left)
    if abs(middle - target.distance_m) > _TAPE_TOLERANCE_M:
        return f"The middle would be at {middle:.3f} m, the station is {target.distance_m:.2f} m."
    if abs(0.5 * abs(top_right - top_left) - half) > _TAPE_TOLERANCE_M:
        return (
            f"At {target.angle_deg:g} deg the sides should differ by {2.0 * half:.2f} m, the tape "
            f"says {abs(top_right - top_left):.2f} m."
        )
    return ""
