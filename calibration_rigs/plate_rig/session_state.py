"""What a session has done so far, in a file that is whole at any time."""

from __future__ import annotations

import csv
import io
import random
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from acquisition.errors import StreamError
from acquisition.files import replacing
from calibration_rigs.errors import RigError
from calibration_rigs.plate_rig.manifest import CORNERS, CellEntry, Environment, first_fault

STATE_NAME = "session.json"
TABLE_NAME = "plate.csv"


class Target(BaseModel):
    """Where the plate is to stand."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    distance_m: float
    angle_deg: float

    @property
    def name(self) -> str:
        """How it is called to the operator."""
        return f"{self.distance_m:.2f} m, {self.angle_deg:g} deg"


class SessionState(BaseModel):
    """The whole state.

    Attributes:
        seed: of the order.
        environment: of all cells.
        order: the cells, in the order in which they are recorded.
        cells: those that are recorded.
        skipped: those that the operator left out.
        warm_up_s, warm_up_z_m: readings of the warm-up.
        is_warm: the warm-up is over.
        attempts: recordings begun so far, whatever became of them; numbers their files.
    """

    model_config = ConfigDict(extra="forbid", populate_by_name=True)

    schema_name: Literal["terravibe/plate-session"] = Field(
        default="terravibe/plate-session", alias="schema"
    )
    version: Literal[1] = 1
    seed: int
    environment: Environment
    order: list[Target]
    cells: list[CellEntry] = []
    skipped: list[Target] = []
    warm_up_s: list[float] = []
    warm_up_z_m: list[float] = []
    is_warm: bool = False
    attempts: int = 0

    def pending(self) -> list[Target]:
        """Return what is left to do, in order."""
        done = {(cell.distance_m, cell.angle_deg) for cell in self.cells}
        done |= {(target.distance_m, target.angle_deg) for target in self.skipped}
        return [t for t in self.order if (t.distance_m, t.angle_deg) not in done]


def random_order(
    stations_m: tuple[float, ...], angles_deg: tuple[float, ...], seed: int
) -> list[Target]:
    """Return every station with every angle, in random order: a drift is then no law of Z."""
    targets = [Target(distance_m=z, angle_deg=a) for z in stations_m for a in angles_deg]
    random.Random(seed).shuffle(targets)  # noqa: S311 - an order, no secret
    return targets


def load_state(folder: Path) -> SessionState | None:
    """Return the state of a session, or None when the folder has none.

    Raises:
        RigError: it is there and cannot be read; nothing is overwritten.
    """
    path = folder / STATE_NAME
    if not path.exists():
        return None
    try:
        return SessionState.model_validate_json(path.read_text(encoding="utf-8"))
    except ValidationError as error:
        raise RigError(
            f"{path}: {first_fault(error)}; mend it, or move it away: the recordings in "
            f"{TABLE_NAME} stay usable without it"
        ) from error
    except (OSError, UnicodeDecodeError) as error:
        raise RigError(f"cannot read {path}: {error}") from error


def save_state(folder: Path, state: SessionState) -> None:
    """Write the state and the table of cells; each is whole at any time.

    Raises:
        RigError: the disk refused; the older files are as they were.
    """
    content = {
        STATE_NAME: state.model_dump_json(indent=2, by_alias=True),
        TABLE_NAME: _table(state.cells),
    }
    try:
        for name, text in content.items():
            with replacing(folder / name) as temporary:
                temporary.write_text(text, encoding="utf-8")
    except (StreamError, OSError) as error:
        raise RigError(f"cannot keep the session's state: {error}; make room and go on") from error


def _table(cells: list[CellEntry]) -> str:
    """Return the cells as plate.csv, which `terravibe calibrate plate` reads."""
    corners = [f"corner_{corner.replace(' ', '_')}_m" for corner in CORNERS]
    text = io.StringIO()
    plain = ("recording", "distance_m", "angle_deg", "environment", "lux", "temperature_c")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*plain, *corners])
    for cell in cells:
        values = [getattr(cell, name) for name in plain] + list(cell.corners_m or [None] * 3)
        writer.writerow("" if value is None else value for value in values)
    return text.getvalue()
