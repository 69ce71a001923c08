"""A block for rover.toml replaces an earlier one of its kind, and nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest

import cli
from acquisition.errors import StreamError
from calibration_rigs.errors import RigError
from calibration_rigs.mount_rig.camera import MOUNT_KEYS
from calibration_rigs.mount_rig.camera import TABLE as MOUNT_TABLE
from calibration_rigs.rover_block import check_block_target
from calibration_rigs.static_rig.delay import Delay
from calibration_rigs.static_rig.delay_session import DELAY_KEYS, TABLE, DelayCalibration


def _check(path: Path) -> None:
    check_block_target(path, TABLE, DELAY_KEYS.values())


@pytest.mark.parametrize("late_s", [0.004, -0.004])
def test_an_earlier_block_of_the_kind_is_replaced(tmp_path: Path, late_s: float) -> None:
    """The early reference's block is an empty table."""
    delays = {"wheels": Delay(late_s, 1e-5, 1.0, 1.0, 20.0)}
    path = tmp_path / "delay.toml"
    path.write_text(DelayCalibration("gyro", late_s, delays, "turns.mcap").toml())
    _check(path)
    with pytest.raises(RigError, match=r"delay\.toml is there and holds map\.ego_motion"):
        check_block_target(path, MOUNT_TABLE, MOUNT_KEYS)


def test_a_new_name_and_an_empty_file_are_taken(tmp_path: Path) -> None:
    _check(tmp_path / "new.toml")
    (tmp_path / "empty.toml").touch()
    _check(tmp_path / "empty.toml")
    with pytest.raises(StreamError, match="it is a folder"):
        _check(tmp_path)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("[recording]\nname = 'moon'\n[map.ego_motion]\n", "holds recording.name, where only an"),
        ("[map.ego_motion]\ngyro_delay_s = 0.1\nx = 1\n", "holds map.ego_motion.x, where only"),
        ("a = 1\nb = 1\nc = 1\nd = 1\ne = []\n", "holds a, b, c and 2 more, where only an earlier"),
        (
            "# only notes\n",
            "holds no settings, where only an earlier .map.ego_motion. is rep",
        ),
        ("notes", "is there and is no TOML file .*; give a new name"),
        ("\xff", "is there and is no TOML file .*; give a new name"),
    ],
)
def test_what_holds_anything_else_is_refused(tmp_path: Path, content: str, reason: str) -> None:
    path = tmp_path / "rover.toml"
    path.write_bytes(content.encode("latin-1"))
    with pytest.raises(RigError, match=reason) as caught:
        _check(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("rig", ["mount", "delay"])
def test_the_whole_configuration_is_not_replaced(
    rig: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rover = tmp_path / "rover.toml"
    assert cli.main(["config", "init", str(rover)]) == 0
    before = rover.read_bytes()
    capsys.readouterr()
    assert cli.main(["calibrate", rig, "no.mcap", "-o", str(rover)]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "give -o a new name, and put the block into rover.toml from there" in line
    assert rover.read_bytes() == before
