"""A guided session: which station and angle next, what to read off the tape, and the recording.

Everything that the operator did is on disk before the next question is asked, so a session can be
broken off at any time and goes on where it was.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from pydantic import ValidationError

from calibration_rigs.errors import RigError
from calibration_rigs.plate_rig.cell_checks import look_at
from calibration_rigs.plate_rig.frames import read_frames
from calibration_rigs.plate_rig.manifest import CellEntry, Environment, Rig, first_fault
from calibration_rigs.plate_rig.questions import CellSkipped, Operator, Questions, SessionLeft
from calibration_rigs.plate_rig.recording import Capture
from calibration_rigs.plate_rig.session_state import (
    TABLE_NAME,
    SessionState,
    Target,
    load_state,
    random_order,
    save_state,
)
from calibration_rigs.plate_rig.warm_up import judge_warm_up, middle_z_m
from drivers.errors import TerravibeError

STATIONS_M = tuple(round(1.0 + 0.2 * k, 1) for k in range(11))
ANGLES_DEG = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0)
_WARM_UP_FRAMES = 30
_WARM_UP_EVERY_S = 60.0

Look = Callable[[Path, CellEntry, Rig], list[str]]


@dataclass(frozen=True, slots=True)
class SessionPlan:
    """What to record.

    Attributes:
        seed: of the random order.
        environment: indoor or outdoor.
        stations_m, angles_deg: every station is recorded at every angle.
        frames: of each cell.
        rig: plate and sensor.
    """

    seed: int = 1
    environment: Environment = "indoor"
    stations_m: tuple[float, ...] = STATIONS_M
    angles_deg: tuple[float, ...] = ANGLES_DEG
    frames: int = 100
    rig: Rig = field(default_factory=Rig)


class PlateSession:
    """Records the cells of a plan into a folder; begins anew or goes on."""

    def __init__(
        self,
        folder: Path,
        plan: SessionPlan,
        capture: Capture,
        operator: Operator,
        clock_s: Callable[[], float] = time.time,
        look: Look | None = None,
    ) -> None:
        """Read the folder's state; record nothing yet.

        Args:
            folder: made when it is missing.
            plan: of a new session; one that goes on keeps its own order and environment.
            capture: records.
            operator: answers.
            clock_s: time that survives a break, seconds.
            look: says what is wrong with a recording; the default analyses it.

        Raises:
            RigError: the state cannot be read, or the folder not made.
        """
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RigError(f"cannot make the folder {folder}: {error.strerror}") from error
        self._folder = folder
        self._plan = plan
        self._capture = capture
        self._operator = Questions(operator)
        self._clock_s = clock_s
        self._look = look or look_at
        self.state = load_state(folder) or SessionState(
            seed=plan.seed,
            environment=plan.environment,
            order=random_order(plan.stations_m, plan.angles_deg, plan.seed),
        )

    def run(self) -> bool:
        """Record what is pending; return whether nothing is left.

        Raises:
            RigError: the state cannot be written.
        """
        save_state(self._folder, self.state)
        try:
            if not self.state.is_warm:
                self._warm_up()
            for target in self.state.pending():
                self._do(target)
        except SessionLeft:
            self._operator.say("Saved. Start the same command again to go on.")
        return not self.state.pending()

    def progress_line(self) -> str:
        """Return how far the session is, and what to do with it."""
        state = self.state
        return (
            f"{len(state.cells)} of {len(state.order)} cells recorded, {len(state.skipped)} left "
            f"out; terravibe calibrate plate {self._folder / TABLE_NAME}"
        )

    def _warm_up(self) -> None:
        """Record the plate in the middle every minute until its distance no longer drifts."""
        nearest_m = min(self._plan.stations_m)
        self._operator.say(
            f"Warm-up: put the plate at {nearest_m:.2f} m, facing the camera, and leave it. This "
            "takes ten minutes or more."
        )
        question = "Enter when it stands, 'skip' if the camera has been on for an hour:"
        if self._operator.answer(question) == "skip":
            self._warm()
            return
        while True:
            z_m, step_m = self._reading()
            self.state.warm_up_z_m.append(z_m)
            self.state.warm_up_s.append(self._clock_s())
            save_state(self._folder, self.state)
            found = judge_warm_up(self.state.warm_up_s, self.state.warm_up_z_m, step_m)
            self._operator.say(f"Drift: {found.text}.")
            if found.is_warm:
                self._warm()
                return
            self._operator.wait(_WARM_UP_EVERY_S)

    def _warm(self) -> None:
        """Keep that the warm-up is over."""
        self.state.is_warm = True
        save_state(self._folder, self.state)

    def _reading(self) -> tuple[float, float]:
        """Return the distance of what is in the middle of the image, and the step there."""
        path, rig = self._next_path("warmup"), self._plan.rig
        self._capture.record(path, _WARM_UP_FRAMES)
        frames = read_frames(path, rig)
        z_m = middle_z_m(frames)
        if not z_m > 0.0:
            raise RigError(f"{path} has no reading in the middle; point the camera at the plate")
        disparity_px_m = rig.disparity_px_m(frames.camera.fx_px, frames.camera.width_px)
        return z_m, z_m**2 * rig.disparity_step_px / disparity_px_m

    def _do(self, target: Target) -> None:
        """Record one cell, as often as the operator wants; it is saved before the next."""
        number = len(self.state.cells) + len(self.state.skipped) + 1
        self._operator.say(f"Cell {number} of {len(self.state.order)}: {target.name}.")
        try:
            while True:
                cell = self._read_off(target)
                if self._recorded(cell):
                    return
        except CellSkipped:
            self.state.skipped.append(target)
            save_state(self._folder, self.state)

    def _read_off(self, target: Target) -> CellEntry:
        """Return the cell with what is read off tape and meters, asked until it can be."""
        last = self.state.cells[-1] if self.state.cells else None
        while True:
            corners_m = self._operator.corners_m(target, self._plan.rig)
            lux = self._operator.number(
                "Light in lux (Enter = as before):", last.lux if last else None
            )
            temperature_c = self._operator.number(
                "Temperature in deg C (Enter = as before):", last.temperature_c if last else None
            )
            try:
                return CellEntry(
                    recording="pending",
                    distance_m=target.distance_m,
                    angle_deg=target.angle_deg,
                    corners_m=corners_m,
                    environment=self.state.environment,
                    lux=lux,
                    temperature_c=temperature_c,
                )
            except ValidationError as error:
                self._operator.say(f"That cannot be: {first_fault(error)}.")

    def _recorded(self, cell: CellEntry) -> bool:
        """Record and look at a cell; return whether it is kept."""
        self._operator.answer("Enter to record; keep away from the plate:")
        path = self._next_path(f"z{100 * cell.distance_m:.0f}_a{cell.angle_deg:.0f}")
        try:
            self._capture.record(path, self._plan.frames)
            named = cell.model_copy(update={"recording": path.name})
            doubts = self._look(path, named, self._plan.rig)
        except TerravibeError as error:
            doubts = [str(error)]
            named = None
        for doubt in doubts:
            self._operator.say(f"! {doubt}")
        if doubts and not self._operator.keeps(can_be_kept=named is not None):
            return False
        if named is not None:
            self.state.cells.append(named)
            save_state(self._folder, self.state)
        return named is not None

    def _next_path(self, name: str) -> Path:
        """Return a new file's path; the number is kept even if nothing comes of it."""
        while True:
            self.state.attempts += 1
            path = self._folder / f"{self.state.attempts:03d}_{name}.mcap"
            if not path.exists():
                save_state(self._folder, self.state)
                return path
