"""What was measured where: the rig and its cells, as plate.toml, plate.csv or a session tell it.

    [rig]
    plate_width_m = 1.0
    baseline_m = 0.075

    [[cells]]
    recording = "z10_a00.mcap"
    distance_m = 1.0
    angle_deg = 0
    corners_m = [1.001, 1.000, 1.001]
    lux = 300

A CSV file has one cell a line under the same names, with corner_top_left_m, corner_top_right_m
and corner_bottom_left_m for the tape, and an empty field where nothing was read. Distances are
taken along the viewing direction, from the front of the camera. A rig.toml beside it may hold the
[rig] table.
"""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from calibration_rigs.errors import RigError
from drivers.errors import reason_of
from mapping.measurement import SENSOR_WIDTH_PX

MANIFEST_NAMES = ("plate.toml", "plate.csv")
RIG_NAME = "rig.toml"
Environment = Literal["indoor", "outdoor"]
CORNERS = ("top left", "top right", "bottom left")

_Positive = Annotated[float, Field(gt=0.0, le=1e3, allow_inf_nan=False)]
_Corners = Annotated[tuple[_Positive, _Positive, _Positive], Field(strict=False)]
_Four = Annotated[tuple[_Positive, _Positive, float, float], Field(strict=False)]
_Angle = Annotated[float, Field(ge=-85.0, le=85.0, allow_inf_nan=False)]
_Lux = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
_Celsius = Annotated[float, Field(ge=-100.0, le=150.0, allow_inf_nan=False)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class Rig(_Strict):
    """[rig]: the plate and the sensor.

    Attributes:
        plate_width_m, plate_height_m: the plate.
        baseline_m: between projector and camera; disparity = focal length x baseline / distance.
        disparity_step_px: step of the disparity, pixels of the sensor's 640 px wide image.
        range_min_m, range_max_m: the sensor reads between these; a plate that reaches beyond is
            seen in part.
        tape_sigma_m: standard deviation of one reading of the tape.
        tape_zero_sigma_m: of what all readings share: where in the camera its zero lies.
        intrinsics_px: fx, fy, cx, cy; needed for folders of images, recordings bring their own.
        model, serial: of the device; needed for folders of images, recordings bring their own.
    """

    plate_width_m: _Positive = 1.0
    plate_height_m: _Positive = 1.0
    baseline_m: _Positive = 0.075
    disparity_step_px: _Positive = 0.125
    range_min_m: _Positive = 0.8
    range_max_m: _Positive = 4.0
    tape_sigma_m: _Positive = 0.001
    tape_zero_sigma_m: _Positive = 0.001
    intrinsics_px: _Four | None = None
    model: str = ""
    serial: str = ""

    def disparity_px_m(self, focal_px: float, width_px: int) -> float:
        """Return focal length times baseline, in pixels of the 640 px wide image times metres."""
        return focal_px * SENSOR_WIDTH_PX / width_px * self.baseline_m


class CellEntry(_Strict):
    """[[cells]]: one recording of the plate at one distance and angle.

    Attributes:
        recording: MCAP file, or folder of 16-bit PNG or PGM images in millimetres; relative to
            the manifest.
        distance_m: of the plate's turning axis, as the station is marked.
        angle_deg: of the tripod; 0 = facing the camera.
        corners_m: tape to the top left, top right and bottom left corner, as the camera sees
            them; None when only the station was measured.
        environment, lux, temperature_c, sun_angle_deg: conditions; the sun's angle is between
            its direction and the plate's normal.
    """

    recording: str
    distance_m: _Positive
    angle_deg: _Angle
    corners_m: _Corners | None = None
    environment: Environment = "indoor"
    lux: _Lux | None = None
    temperature_c: _Celsius | None = None
    sun_angle_deg: Annotated[float, Field(ge=0.0, le=180.0)] | None = None

    @property
    def name(self) -> str:
        """How the cell is called in messages and tables."""
        place = "" if self.environment == "indoor" else f" {self.environment}"
        return f"{self.distance_m:.2f} m / {self.angle_deg:g} deg{place}"


class RigFile(_Strict):
    """The whole file."""

    rig: Rig = Rig()
    cells: Annotated[tuple[CellEntry, ...], Field(strict=False, min_length=1)]


@dataclass(frozen=True, slots=True)
class Manifest:
    """A rig file, and the folder that its recordings are relative to."""

    folder: Path
    rig: Rig
    cells: tuple[CellEntry, ...]


def read_manifest(path: Path) -> Manifest:
    """Read plate.toml or plate.csv, given as such or by its folder.

    Raises:
        RigError: not there, not readable, or not of the form above; names file and place.
    """
    if path.is_dir():
        path = _in_folder(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
        is_table = path.suffix.lower() == ".csv"
        found = RigFile.model_validate(_from_csv(text) if is_table else tomllib.loads(text))
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise RigError(
            f"cannot read {path}: {reason_of(error)}; expected a plate.toml or .csv"
        ) from error
    except ValidationError as error:
        raise RigError(f"{path}: {first_fault(error)}") from error
    rig = read_rig(path.parent) if is_table else found.rig
    return Manifest(path.parent, rig, found.cells)


def read_rig(folder: Path) -> Rig:
    """Return the [rig] of a folder's rig.toml, or the default where there is none.

    Raises:
        RigError: it cannot be read, or is not of the form above.
    """
    path = folder / RIG_NAME
    if not path.exists():
        return Rig()
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
        return Rig.model_validate(values.get("rig", {}))
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise RigError(f"cannot read {path}: {reason_of(error)}; expected a [rig] table") from error
    except ValidationError as error:
        raise RigError(f"{path}: {first_fault(error)}") from error


def _in_folder(folder: Path) -> Path:
    for name in MANIFEST_NAMES:
        if (folder / name).is_file():
            return folder / name
    raise RigError(
        f"{folder} has neither {' nor '.join(MANIFEST_NAMES)}; write one that lists the cells, "
        "or record them with --session"
    )


def _from_csv(text: str) -> dict[str, object]:
    rows = csv.DictReader(text.splitlines())
    return {"cells": [_cell_of(row) for row in rows]}


def _cell_of(row: Mapping[str | None, str | list[str] | None]) -> dict[str, object]:
    """Return a line's fields as a [[cells]] table; what is no number stays text and is refused."""
    cell: dict[str, object] = {
        str(name): _number(value.strip()) if name not in ("recording", "environment") else value
        for name, value in row.items()
        if isinstance(value, str) and value.strip()
    }
    names = [f"corner_{corner.replace(' ', '_')}_m" for corner in CORNERS]
    corners = [cell.pop(name) for name in names if name in cell]
    return cell | ({"corners_m": corners} if corners else {})


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def first_fault(error: ValidationError) -> str:
    """Return what pydantic found first, as `place: what`; cells are counted from 1."""
    first = error.errors(include_url=False)[0]
    parts = [f"{part + 1}" if isinstance(part, int) else part for part in first["loc"]]
    return f"{' '.join(parts) or 'the file'}: {first['msg']}"
