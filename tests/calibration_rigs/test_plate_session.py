"""The guided session: asks, checks, records, and loses nothing."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import cli
from calibration_rigs.errors import RigError
from calibration_rigs.plate_rig.cell_checks import tape_doubt
from calibration_rigs.plate_rig.command import Keyboard
from calibration_rigs.plate_rig.manifest import CellEntry, Rig, read_manifest
from calibration_rigs.plate_rig.recording import RoverCapture, SourceCapture
from calibration_rigs.plate_rig.session import PlateSession, SessionPlan
from calibration_rigs.plate_rig.session_state import Target, load_state, random_order
from calibration_rigs.plate_rig.warm_up import judge_warm_up
from drivers.errors import DriverError
from drivers.samples import CameraIntrinsics
from tests.fakes.plate_rig import Plate, PlateCamera, frames_of

CAMERA = CameraIntrinsics(160, 120, 145.0, 145.0, 79.5, 59.5)


class Scripted:
    """An operator who reads the true tape, and does what a test tells at certain questions."""

    def __init__(self, **answers: Callable[[str], str] | str) -> None:
        self.said: list[str] = []
        self.asked: list[str] = []
        self.waited_s = 0.0
        self.target = Target(distance_m=1.0, angle_deg=0.0)
        self._answers = answers

    def say(self, text: str) -> None:
        self.said.append(text)
        if text.startswith("Cell "):
            station, angle = text.split(": ")[1].split(", ")
            self.target = Target(
                distance_m=float(station.split()[0]), angle_deg=float(angle.split()[0])
            )

    def ask(self, question: str) -> str:
        self.asked.append(question)
        for word, answer in self._answers.items():
            if word in question:
                return answer if isinstance(answer, str) else answer(question)
        if "Tape" in question:
            plate = Plate(self.target.distance_m, self.target.angle_deg)
            return " ".join(map(str, plate.corners_m(np.random.default_rng(0))))
        return ""

    def wait(self, seconds: float) -> None:
        self.waited_s += seconds


class Touch:
    """A capture that makes an empty file; fails or is interrupted at a chosen recording."""

    def __init__(self, stops_at: int = -1, error: BaseException | None = None) -> None:
        self.calls = 0
        self.paths: list[Path] = []
        self._stops_at, self._error = stops_at, error

    def record(self, path: Path, frames: int) -> None:
        self.calls += 1
        path.touch(exist_ok=False)
        if self.calls == self._stops_at and self._error is not None:
            raise self._error
        self.paths.append(path)


def _nothing_wrong(path: Path, cell: CellEntry, rig: Rig) -> list[str]:
    return []


def _session(folder: Path, capture: Touch, operator: Scripted) -> PlateSession:
    return PlateSession(folder, SessionPlan(), capture, operator, look=_nothing_wrong)


def test_the_order_is_random_complete_and_seeded() -> None:
    order = random_order((1.0, 1.2), (0.0, 15.0, 30.0), 1)
    assert {(t.distance_m, t.angle_deg) for t in order} == {
        (z, a) for z in (1.0, 1.2) for a in (0.0, 15.0, 30.0)
    }
    assert order == random_order((1.0, 1.2), (0.0, 15.0, 30.0), 1)
    assert order != random_order((1.0, 1.2), (0.0, 15.0, 30.0), 2)


def test_interrupted_at_cell_40_and_continued(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        _session(tmp_path, Touch(40, KeyboardInterrupt()), Scripted(hour="skip")).run()
    state = load_state(tmp_path)
    assert state is not None
    assert len(state.cells) == 39
    assert len(read_manifest(tmp_path).cells) == 39
    before = [cell.recording for cell in state.cells]
    again = Touch()
    session = _session(tmp_path, again, Scripted(hour="skip"))
    assert session.run()
    assert again.calls == 27  # cell 40 is recorded anew, under a name of its own
    assert [cell.recording for cell in session.state.cells[:39]] == before
    places = {(cell.distance_m, cell.angle_deg) for cell in session.state.cells}
    assert len(places) == len(session.state.cells) == 66
    assert session.progress_line().startswith("66 of 66 cells recorded")
    assert not [path for path in tmp_path.iterdir() if ".part" in path.name]


def test_quit_is_no_loss(tmp_path: Path) -> None:
    asked = iter(["skip", "1 1 1"])
    operator = Scripted(hour="skip", Tape=lambda _: next(asked, "quit"), doubt="quit", right="quit")
    session = _session(tmp_path, Touch(), operator)
    assert not session.run()
    assert operator.said[-1] == "Saved. Start the same command again to go on."
    assert len(session.state.skipped) == 1
    assert len(session.state.pending()) == 65


def test_a_camera_that_fails_is_tried_again(tmp_path: Path) -> None:
    operator = Scripted(hour="skip", again="again", Light="300", Temperature="20")
    capture = Touch(3, DriverError("depth: unplugged"))
    session = _session(tmp_path, capture, operator)
    assert session.run()
    assert "! depth: unplugged" in operator.said
    assert capture.calls == 67
    assert {cell.lux for cell in session.state.cells} == {300.0}


def test_what_cannot_be_is_asked_again(tmp_path: Path) -> None:
    answers = iter(["-1 -1 -1", "nan 1 1", "far", "1 1 1", "quit"])
    operator = Scripted(hour="skip", Tape=lambda _: next(answers), right="yes")
    session = _session(tmp_path, Touch(), operator)
    assert not session.run()
    assert sum(text.startswith("That cannot be: corners_m") for text in operator.said) == 2
    assert "Expected three numbers such as 1.002 1.001 1.003." in operator.said
    assert len(session.state.cells) == 1


def test_a_state_that_is_damaged_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "session.json").write_text('{"version": 1}')
    with pytest.raises(RigError, match=r"session\.json: seed: Field required; mend it, or move"):
        _session(tmp_path, Touch(), Scripted())
    assert json.loads((tmp_path / "session.json").read_text()) == {"version": 1}


@pytest.mark.parametrize(
    ("corners", "doubt"),
    [
        ((1.0, 1.001, 0.999), ""),
        ((1.2, 1.0, 1.0), "Both left corners should be equally far"),
        ((1.2, 1.2, 1.2), "The middle would be at 1.200 m, the station is 1.00 m"),
        ((1.2, 0.8, 1.2), "At 0 deg the sides should differ by 0.00 m"),
    ],
)
def test_the_tape_is_doubted_at_once(corners: tuple[float, float, float], doubt: str) -> None:
    found = tape_doubt(corners, Target(distance_m=1.0, angle_deg=0.0), Rig())
    assert found.startswith(doubt)
    assert bool(found) == bool(doubt)


def test_warm_up() -> None:
    minutes = [60.0 * k for k in range(12)]
    step_m = 0.00287
    assert "10 min to go" in judge_warm_up([], [], step_m).text
    assert not judge_warm_up(minutes[:5], [1.0] * 5, step_m).is_warm
    still = judge_warm_up(minutes, [1.0] * 12, step_m)
    assert still.is_warm
    drifting = judge_warm_up(minutes, [1.0 + 1e-6 * t for t in minutes], step_m)
    assert not drifting.is_warm
    assert drifting.drift_m == pytest.approx(6e-4)
    assert "+0.60 ± 0.00 mm in 10 min, not below 0.29 mm" in drifting.text
    # One hour later the first minutes, when it drifted, no longer count.
    later = [*minutes, *(3600.0 + t for t in minutes)]
    assert judge_warm_up(later, [1.1] * 12 + [1.0] * 12, step_m).is_warm


def test_a_session_through_the_real_recorder(tmp_path: Path) -> None:
    """Warm-up and one cell: recorded by the recorder, read back, analysed on the spot."""
    depth_mm = frames_of(Plate(1.4, 0.0), 12, 0, camera=CAMERA)
    capture = SourceCapture(lambda: [PlateCamera(depth_mm, CAMERA)])
    now = iter(np.arange(100) * 61.0)
    plan = SessionPlan(stations_m=(1.4,), angles_deg=(0.0,), frames=12)
    operator = Scripted(again="keep")
    session = PlateSession(tmp_path, plan, capture, operator, clock_s=lambda: float(next(now)))
    session.state.warm_up_s = [-61.0 * k for k in range(12, 0, -1)]
    session.state.warm_up_z_m = [float(depth_mm[:, 40:80, 54:106].mean()) / 1e3] * 12
    assert session.run()
    assert session.state.is_warm
    assert any("12 frames, expected at least 100" in text for text in operator.said)
    assert [cell.recording for cell in read_manifest(tmp_path).cells] == ["002_z140_a0.mcap"]


def test_a_rover_without_a_depth_camera(tmp_path: Path) -> None:
    config = tmp_path / "rover.toml"
    config.write_text('[[devices]]\nkind = "gyro"\n')
    with pytest.raises(RigError, match=r"rover\.toml has no depth camera; expected"):
        RoverCapture(config)


def test_the_keyboard_takes_an_end_of_input_for_quit(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def nobody(prompt: str) -> str:
        raise EOFError

    keyboard = Keyboard(cli.Terminal())
    monkeypatch.setattr("builtins.input", nobody)
    assert keyboard.ask("How far?") == "quit"
    monkeypatch.setattr("builtins.input", lambda prompt: " 1.0 ")
    assert keyboard.ask("How far?") == "1.0"
    assert capsys.readouterr().out == "How far?\nHow far?\n"
