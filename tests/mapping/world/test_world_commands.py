"""terravibe map --world and terravibe export of a world."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import cli
from acquisition.importing import record_all
from mapping.output.map_file import read_map
from simulation.devices.ideal_camera import IDEAL_CAMERA_NOISE
from simulation.ideal_drive import IdealDrive
from tests.mapping.scenes import mount


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recorded") / "run.mcap"
    record_all(
        IdealDrive(2, 0.2),
        path,
        static_transforms=mount().transforms,
        settings={"depth_noise": IDEAL_CAMERA_NOISE},
    )
    return path


def _words(*words: object) -> list[str]:
    return [str(word) for word in words]


def test_a_recording_becomes_a_world_and_a_part_of_it_a_map(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    world, part, plain = tmp_path / "w.zarr", tmp_path / "part.nc", tmp_path / "plain.nc"
    command = _words("map", recording, "--world", world, "--window-m", 12, "--json")
    assert cli.main(command) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["output"] == str(world)
    assert cli.main(_words("map", recording, "-o", plain)) == 0
    assert cli.main(_words("export", world, "-o", part)) == 0
    assert read_map(part).sha256() == read_map(plain).sha256()
    capsys.readouterr()
    assert cli.main(_words("info", world, "--json")) == 0
    assert json.loads(capsys.readouterr().out)["sha256"] == read_map(plain).sha256()
    window = _words("export", world, "--window", 1, -0.5, 1.5, 0.5, "-o", tmp_path / "part.tif")
    assert cli.main(window) == 0
    assert (tmp_path / "part.tif").stat().st_size > 1000
    assert cli.main(_words("map", recording, "--world", world)) == 2
    assert "give --continue" in capsys.readouterr().err


def test_frames_that_a_world_has_are_not_counted_again(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The recording's beginning stands for a run that a crash has ended."""
    world, begin, part, plain = (tmp_path / name for name in ("w", "b.mcap", "p.nc", "plain.nc"))
    assert cli.main(_words("cut", recording, "-o", begin, "--end-s", 0.09)) == 0
    assert cli.main(_words("map", begin, "--world", world)) == 0
    assert cli.main(_words("map", recording, "-o", plain)) == 0
    again = _words("map", recording, "--world", world, "--continue", "-o", part)
    capsys.readouterr()
    for told in ("1 depth frames were in the world already", "2 depth frames were in the world"):
        assert cli.main(again) == 0
        assert told in capsys.readouterr().err
        assert read_map(part).sha256() == read_map(plain).sha256()


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["map", "x.mcap"], "nothing to write; give -o FILE.nc, --world DIR.zarr, or both"),
        (["map", "x.mcap", "--world", "w", "--grid", "growing"], "leave --grid out"),
        (["map", "x.mcap", "-o", "m.nc", "--continue"], "give --world DIR.zarr too"),
        (["export", __file__, "--window", "0", "0", "1", "1", "-o", "a.tif"], "is for world maps"),
        (["export", "no.zarr", "--window", "0", "0", "1", "1", "-o", "a.tif"], "is no world at no"),
        (["export", "no.nc", "--window", "0", "0", "1", "1", "-o", "a.tif"], "cannot read no.nc"),
        (["info", "no.zarr"], "there is no world at no.zarr; check the name"),
    ],
)
def test_contradictions_and_wrong_names_are_one_line(
    words: list[str], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(words) == 2
    error = capsys.readouterr().err
    assert reason in error
    assert error.count("\n") == 1


def test_a_new_world_is_not_left_where_nothing_came_into_it(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "there").mkdir()
    for name in ("new", "there"):
        words = _words("map", recording, "--world", tmp_path / name, "--pose-source", "ego-motion")
        assert cli.main(words) == 2
    assert list(tmp_path.rglob("*")) == [tmp_path / "there"]
    assert capsys.readouterr().err.count("ego-motion has nothing to go by\n") == 2


def test_a_world_continues_with_its_own_poses_alone(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = _words("map", recording, "--world", tmp_path / "w")
    assert cli.main(command) == 0
    before = sorted((path, path.stat().st_mtime_ns) for path in tmp_path.rglob("[!w]*"))
    capsys.readouterr()
    assert cli.main([*command, "--continue", "--pose-source", "mocap+alignment"]) == 2
    assert "give --pose-source mocap, or a new world" in capsys.readouterr().err
    assert sorted((path, path.stat().st_mtime_ns) for path in tmp_path.rglob("[!w]*")) == before
