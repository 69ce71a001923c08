"""The run that a world's cells are from, on disk.

`run.json` says which save the world is at, where the rover was then and what its poses were worth;
it is replaced as a whole. `motions.f64` has the motions' sums (`mapping.motion.ledger`) without
their row of zeros, `frames.i64` the depth frames (`mapping.motion.known_frames`): eight
little-endian float64 a row, and two int64. Rows are only ever added: those that `run.json` does
not count yet belong to a save that was not finished.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.files import replacing
from mapping.errors import MappingError
from mapping.geometry import RigidTransform, UncertainPose
from mapping.motion.known_frames import Keys
from mapping.motion.ledger import Motions
from mapping.motion.pose_errors import PoseErrorModel
from mapping.motion.read_out import Rover
from mapping.motion.repeats import Rest
from mapping.motion.run_state import RunState
from mapping.world.row_file import RowCount, RowFile

Float64Array = NDArray[np.float64]

RUN_FILE, MOTIONS_FILE, FRAMES_FILE = "run.json", "motions.f64", "frames.i64"


class SavedRun(NamedTuple):
    """A run, and the number of the save that it is as of: 0 = none yet."""

    save: int
    run: RunState


class RunFile:
    """Reads and writes the three files.

    Args:
        folder: the world's.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._motions = RowFile(folder / MOTIONS_FILE, "<f8", 8)
        self._frames = RowFile(folder / FRAMES_FILE, "<i8", 2)

    def read(self) -> SavedRun:
        """Return what was last written.

        Raises:
            MappingError: the files are missing or damaged.
        """
        try:
            text = (self._folder / RUN_FILE).read_text(encoding="utf-8")
            found = json.loads(text)
            rows = self._motions.read(RowCount(int(found["rows"]), int(found["rows_crc32"])))
            sums = np.concatenate([np.zeros((1, 8)), rows])
            saved = SavedRun(int(found["save"]), _run_of(found, sums, self._keys(found)))
        except (OSError, LookupError, ValueError, TypeError) as error:
            raise MappingError(
                f"what the world {self._folder} says of its run is damaged "
                f"({type(error).__name__}: {error}); take {RUN_FILE}, {MOTIONS_FILE} and "
                f"{FRAMES_FILE} from a backup, or map its recordings into a new world"
            ) from error
        return saved

    def write(self, saved: SavedRun) -> None:
        """Replace what was written; call `read` first where there is something.

        Raises:
            OSError, StreamError: it cannot be written; all stays as it was.
        """
        motions, keys = saved.run.rover.motions, saved.run.frames
        rows = self._motions.append(motions.sums[self._motions.count.rows + 1 : motions.now + 1])
        content = {
            "save": saved.save,
            "rows": rows.rows,
            "rows_crc32": rows.crc32,
            "anchor_m": [motions.anchor_x_m, motions.anchor_y_m],
            "place_m": [saved.run.rover.x_m, saved.run.rover.y_m],
            "pose_errors": asdict(saved.run.rover.pose_errors),
            "pose": _as_json(saved.run.pose),
            "told": _as_json(saved.run.told),
            "slid_rad": saved.run.slid_rad,
            "rest": _rest_as_json(saved.run.rest),
        }
        frames = self._frames.count
        if keys is not None:
            frames = self._frames.append(keys[frames.rows :])
            content |= {"frames": frames.rows, "frames_crc32": frames.crc32}
        with replacing(self._folder / RUN_FILE) as temporary:
            temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        self._motions.count, self._frames.count = rows, frames

    def _keys(self, found: dict[str, Any]) -> Keys | None:
        """Return the frames; None in a world of before they were kept.

        Raises:
            OSError, ValueError, LookupError: they are there and not those that were written.
        """
        if "frames" not in found:
            return None
        keys = self._frames.read(RowCount(int(found["frames"]), int(found["frames_crc32"])))
        return np.asarray(keys, np.int64)


def unfinished(folder: Path) -> list[Path]:
    """Return what a killed writer of the run has left."""
    return list(folder.glob(f".{Path(RUN_FILE).stem}.*.part.json"))


def _run_of(found: dict[str, Any], sums: Float64Array, keys: Keys | None) -> RunState:
    anchor_x_m, anchor_y_m = map(float, found["anchor_m"])
    x_m, y_m = map(float, found["place_m"])
    motions = Motions(sums, len(sums) - 1, anchor_x_m, anchor_y_m)
    rover = Rover(x_m, y_m, motions, PoseErrorModel(**found["pose_errors"]))
    pose, told = _pose_of(found["pose"]), _pose_of(found["told"])
    # Worlds of before the camera's rest was kept have none.
    rest = _rest_of(found.get("rest"))
    return RunState(rover, pose, told, float(found["slid_rad"]), rest, keys)


def _as_json(pose: UncertainPose | None) -> dict[str, Any] | None:
    if pose is None:
        return None
    return {
        "t_ns": pose.t_ns,
        **_transform_as_json(pose.transform),
        "covariance": pose.covariance.tolist(),
    }


def _rest_as_json(rest: Rest | None) -> dict[str, Any] | None:
    return None if rest is None else {**_transform_as_json(rest.place), "repeats": rest.repeats}


def _transform_as_json(transform: RigidTransform) -> dict[str, Any]:
    return {
        "rotation": transform.rotation.tolist(),
        "translation_m": transform.translation_m.tolist(),
    }


def _pose_of(found: dict[str, Any] | None) -> UncertainPose | None:
    if found is None:
        return None
    covariance = np.array(found["covariance"], np.float64).reshape(6, 6)
    return UncertainPose(int(found["t_ns"]), _transform_of(found), covariance)


def _rest_of(found: dict[str, Any] | None) -> Rest | None:
    return None if found is None else Rest(_transform_of(found), int(found["repeats"]))


def _transform_of(found: dict[str, Any]) -> RigidTransform:
    rotation = np.array(found["rotation"], np.float64).reshape(3, 3)
    return RigidTransform(rotation, np.array(found["translation_m"], np.float64).reshape(3))
