"""terravibe map --method paper2019 says what it is, on the screen and in the file."""

from __future__ import annotations

from pathlib import Path

import pytest

import cli
from acquisition.importing import record_all
from mapping.output.map_file import read_map
from mapping.paper2019.faults import FAULTS
from simulation.devices.ideal_camera import IDEAL_CAMERA_NOISE
from simulation.ideal_drive import IdealDrive
from tests.mapping.scenes import mount


def test_the_printed_map_comes_with_its_faults(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, plain, printed = (tmp_path / name for name in ("run.mcap", "a.nc", "b.nc"))
    settings = {"depth_noise": IDEAL_CAMERA_NOISE}
    record_all(IdealDrive(2, 0.2), run, static_transforms=mount().transforms, settings=settings)
    assert cli.main(["map", str(run), "-o", str(plain)]) == 0
    assert not any(fault in capsys.readouterr().err for fault in FAULTS)
    assert cli.main(["map", str(run), "-o", str(printed), "--method", "paper2019"]) == 0
    told = capsys.readouterr().err
    assert all(fault in told for fault in FAULTS)
    found = read_map(printed)
    assert found.attributes["method"] == "paper2019"
    assert found.pixels.sum() == found.attributes["input_readings"]
    assert found.frames.sum() == found.attributes["input_updates"]
    assert found.attributes["input_readings"] == read_map(plain).attributes["input_readings"]
    assert cli.main(["map", str(run), "--world", "w", "--method", "paper2019"]) == 2
    assert "leave --world out" in capsys.readouterr().err
