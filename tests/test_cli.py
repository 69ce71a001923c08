"""The command line as users meet it: exit codes, one line for an error, nothing half-written."""

from __future__ import annotations

import ast
import json
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import cli
from acquisition.commands.console import CHECK_FAILED, OK
from acquisition.editing.recording_copy import RecordingCopy
from acquisition.inspection import check, inspect
from mapping import kernel_cache
from mapping.ground.fill import fill_gaps
from mapping.judging.truth import read_truth
from mapping.output.map_file import read_map
from simulation.run_summary import SimulatedRun
from tests.fakes.recordings import pose
from tests.fakes.recordings import recording as sound_recording

_ROOT = Path(__file__).resolve().parents[1]
_UNUSABLE = 2
_INTRINSICS = "32,32,15.5,11.5"


@pytest.fixture
def tum_folder(tmp_path: Path) -> Path:
    """Return a small recording of a floor, seen by a camera that looks straight down."""
    folder = tmp_path / "tum"
    (folder / "depth").mkdir(parents=True)
    index, poses = ["# depth maps"], ["# ground truth"]
    for i in range(6):
        stamp = f"{1000 + i}.000000"
        depth = np.full((24, 32), 5 * (1000 + i % 2), np.uint16)
        Image.fromarray(depth).save(folder / "depth" / f"{stamp}.png")
        index.append(f"{stamp} depth/{stamp}.png")
        poses.append(f"{stamp} {0.01 * i} 0 1 1 0 0 0")
    (folder / "depth.txt").write_text("\n".join(index) + "\n")
    (folder / "groundtruth.txt").write_text("\n".join(poses) + "\n")
    return folder


@pytest.fixture
def recording(tum_folder: Path, tmp_path: Path) -> Path:
    """Return that folder as a recording."""
    path = tmp_path / "run.mcap"
    assert (
        cli.main(["import", "tum", str(tum_folder), "--intrinsics", _INTRINSICS, "-o", str(path)])
        == OK
    )
    return path


def run_map(recording: Path, output: Path, *extra: str) -> int:
    """Map a recording."""
    return cli.main(["map", str(recording), "-o", str(output), *extra])


def test_import_info_check_map_evaluate_export(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    map_file = tmp_path / "map.nc"
    assert cli.main(["info", str(recording), "--json"]) == OK
    assert cli.main(["check", str(recording)]) == OK
    capsys.readouterr()
    assert run_map(recording, map_file, "--json") == OK
    counts = json.loads(capsys.readouterr().out)["counts"]
    assert counts["frames"] == 6
    assert counts["readings"] == 6 * 24 * 32
    assert counts["readings_outside"] == 0
    assert cli.main(["evaluate", str(map_file), "--floor-height-m", "0", "--json"]) == OK
    floor = json.loads(capsys.readouterr().out)["floor"]["confirmed"]
    assert abs(floor["median_m"]) < 0.002
    floor_figures = ["--floor-height-m", "0", "--figures", str(tmp_path / "figures")]
    assert cli.main(["evaluate", str(map_file), *floor_figures]) == _UNUSABLE
    assert "need --truth" in capsys.readouterr().err
    for name in ("out.tif", "out.ply", "out.png"):
        assert cli.main(["export", str(map_file), "-o", str(tmp_path / name)]) == OK
        assert (tmp_path / name).stat().st_size > 0


def test_what_import_and_export_wrote_is_json_for_scripts(
    tum_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, map_file, sheet = (str(tmp_path / name) for name in ("r.mcap", "map.nc", "out.tif"))
    words = ["import", "tum", str(tum_folder), "--intrinsics", _INTRINSICS, "-o", path]
    assert cli.main([*words, "--json"]) == OK
    said = json.loads(capsys.readouterr().out)
    assert (said["output"], said["duration_s"]) == (path, 5.0)
    assert said["samples"] == {"PoseSample": 6, "DepthFrame": 6}
    assert run_map(Path(path), Path(map_file)) == OK
    capsys.readouterr()
    assert cli.main(["export", map_file, "-o", sheet, "--json"]) == OK
    exported = json.loads(capsys.readouterr().out)
    assert (exported["output"], exported["figures"]) == (sheet, None)
    map_ = read_map(Path(map_file))
    assert exported["shape"] == list(map_.state.shape)
    assert exported["sha256"] == map_.sha256()


def test_same_bits_from_file_pipe_and_second_run(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def checksum(text: str) -> str:
        return str(json.loads(text)["map"]["sha256"])

    assert run_map(recording, tmp_path / "a.nc", "--json") == OK
    from_file = checksum(capsys.readouterr().out)
    assert run_map(recording, tmp_path / "b.nc", "--json", "--follow") == OK
    assert checksum(capsys.readouterr().out) == from_file
    with recording.open("rb") as stream:
        piped = subprocess.run(
            [sys.executable, "-m", "cli", "map", "-", "-o", str(tmp_path / "c.nc"), "--json"],
            stdin=stream,
            cwd=_ROOT,
            capture_output=True,
            check=True,
        )
    assert checksum(piped.stdout.decode()) == from_file


def test_a_map_without_a_confirmed_cell_is_summed_up_and_not_drawn(
    tum_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (first,) = (tum_folder / "depth.txt").read_text().splitlines()[1:2]
    (tum_folder / "depth.txt").write_text(first)
    path, figures = tmp_path / "one.mcap", tmp_path / "figures"
    words = ["import", "tum", str(tum_folder), "--intrinsics", _INTRINSICS, "-o", str(path)]
    assert cli.main(words) == OK
    assert run_map(path, tmp_path / "map.nc", "--figures", str(figures)) == OK
    told = capsys.readouterr()
    assert "no height is confirmed" in told.out
    assert f"nothing is drawn into {figures}: no cell of the map is confirmed" in told.err
    assert not figures.exists()


def test_gaps_are_filled_only_when_asked_for(recording: Path, tmp_path: Path) -> None:
    assert run_map(recording, tmp_path / "open.nc") == OK
    assert run_map(recording, tmp_path / "filled.nc", "--fill-gaps-up-to-m", "0.12") == OK
    as_measured, filled = (read_map(tmp_path / f"{name}.nc") for name in ("open", "filled"))
    assert "gaps_filled_up_to_m" not in as_measured.attributes
    assert filled.attributes["gaps_filled_up_to_m"] == 0.12
    assert fill_gaps(as_measured, 0.12).sha256() == filled.sha256()


def test_truncated_recording_is_mapped_with_a_warning(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recording.read_bytes()[: recording.stat().st_size * 6 // 10])
    assert run_map(cut, tmp_path / "map.nc") == OK
    assert "no proper end" in capsys.readouterr().err


def test_flipped_byte_is_reported_and_never_mapped_silently(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = bytearray(recording.read_bytes())
    content[len(content) // 2] ^= 0x10
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(content)
    assert run_map(damaged, tmp_path / "map.nc") in (CHECK_FAILED, _UNUSABLE)
    assert "offset" in capsys.readouterr().err
    assert cli.main(["check", str(damaged)]) == CHECK_FAILED


def simulate(folder: Path) -> list[str]:
    """Return the arguments of a short simulated run into a folder."""
    files = ["-o", str(folder / "run.mcap"), "--truth", str(folder / "truth.nc")]
    return ["simulate", "simulation", "--seed", "5", "--seconds", "4", *files]


def write_track(truth: Path, path: Path) -> Path:
    """Write the true poses at the depth frames as lines of stamp, position and quaternion."""
    poses = read_truth(truth).poses
    assert poses is not None
    rows = np.column_stack([poses.position_m, poses.quat_xyzw])[::100].tolist()
    stamps = [f"{t_ns // 10**9}.{t_ns % 10**9:09d}" for t_ns in poses.t_ns[::100].tolist()]
    lines = [
        f"{stamp} {' '.join(map(str, row))}\n" for stamp, row in zip(stamps, rows, strict=True)
    ]
    path.write_text("".join(lines))
    return path


def test_a_simulated_run_is_mapped_and_judged_and_is_the_same_in_another_process(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = [tmp_path / "one", tmp_path / "two"]
    for folder in folders:
        folder.mkdir()
    words = [sys.executable, "-m", "cli", *simulate(folders[1])]
    with subprocess.Popen(words, cwd=_ROOT, stdout=subprocess.DEVNULL) as other:  # meanwhile
        assert cli.main([*simulate(folders[0]), "--json"]) == OK
    assert other.returncode == 0
    said = json.loads(capsys.readouterr().out)
    (images,) = [t for t in inspect(folders[0] / "run.mcap").topics if t.topic == "/depth/image"]
    assert (said["duration_s"], said["samples"]["DepthFrame"]) == (4.0, images.messages)
    slow = SimulatedRun(**said | {"took_s": 5.0})
    assert slow.describe()[2] == "took 5.0 s, 0.80 times as fast as real time"
    assert said["bytes"] == (folders[0] / "run.mcap").stat().st_size
    for name in ("run.mcap", "truth.nc"):
        assert (folders[0] / name).read_bytes() == (folders[1] / name).read_bytes()
    assert {path.name for path in folders[0].iterdir()} == {"run.mcap", "truth.nc"}
    run, truth, map_file = folders[0] / "run.mcap", folders[0] / "truth.nc", tmp_path / "map.nc"
    # Frames on a CAN bus come in bursts, which look like gaps between the bursts.
    assert {(found.kind, found.topic) for found in check(run)} <= {("gap", "/can")}
    assert run_map(run, map_file) == OK
    capsys.readouterr()
    assert cli.main(["evaluate", str(map_file), "--truth", str(truth), "--json"]) == OK
    scores = json.loads(capsys.readouterr().out)
    assert scores["rmse_m"] < 0.003
    assert scores["completeness"] > 0.9
    # Poses that the map was made with can be given; here they are the true ones.
    track = write_track(truth, tmp_path / "track.txt")
    words = ["evaluate", str(map_file), "--truth", str(truth), "--trajectory", str(track)]
    assert cli.main([*words, "--json"]) == OK
    again = json.loads(capsys.readouterr().out)
    assert again["relative"]["at_end"]["cells"] > 1000
    assert again["relative"]["at_end"]["rmse_m"] == pytest.approx(
        scores["relative"]["at_end"]["rmse_m"], abs=1e-6
    )


def test_devices_lists_and_checks_profiles(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["devices", "--json"]) == OK
    assert isinstance(json.loads(capsys.readouterr().out)["devices"], list)
    assert cli.main(["devices", "check-profile", "wtvb01-485"]) == OK
    profile = tmp_path / "mine.toml"
    profile.write_text("[profile]\nname = 3\n")
    capsys.readouterr()
    assert cli.main(["devices", "check-profile", str(profile)]) == CHECK_FAILED
    assert f"{profile}:2: found" in capsys.readouterr().out
    assert cli.main(["devices", "check-profile", str(tmp_path / "none.toml")]) == _UNUSABLE
    assert cli.main(["devices", "udev-rules"]) == OK
    assert Path(capsys.readouterr().out.strip()).is_file()
    assert cli.main(["devices", "--json", "udev-rules"]) == OK
    assert Path(json.loads(capsys.readouterr().out)["path"]).is_file()
    assert cli.main(["devices", "--json", "check-profile", str(profile)]) == CHECK_FAILED
    assert json.loads(capsys.readouterr().out)["problems"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["map", "missing.mcap", "-o", "x.nc"], "missing.mcap"),
        (["map", "{tmp}/tum/depth.txt", "-o", "x.nc"], "expected an MCAP"),
        (["odometry", "missing.mcap", "-o", "x.nc"], "missing.mcap"),
        (["map", "{recording}", "-o", "no/such/folder/x.nc"], "no folder"),
        (["map", "{recording}", "-o", "{tmp}/x.nc", "--resolution", "0"], "resolution_m"),
        (["map", "{recording}", "-o", "{tmp}/x.nc", "--noise", "unheard-of"], "unheard-of"),
        (["map", "{recording}", "-o", "{tmp}/x.nc", "--noise", "constant:-1"], "above 0"),
        (["map", "{recording}", "-o", "{tmp}/x.nc", "--range-min-m", "5"], "range_min_m"),
        (["map", "{recording}", "-o", "{tmp}/x.nc", "--gate-sigma", "1e300"], "gate_sigma"),
        (["map", "{recording}", "-o", "{tmp}/x.nc", "--idle-timeout-s", "1"], "--follow"),
        (["map", "{recording}", "-o", "{tmp}/x.nc", "--window-m", "1"], "a growing map has none"),
        (["map", "{recording}", "-o", "{tmp}/x.nc", "--tilt-source", "level"], "their own tilt"),
        (["map", "{recording}", "-o", "{tmp}/x.nc", "--figures", "{recording}/x"], "is no folder"),
        (["map", "{recording}", "-o", "{tmp}/x.nc", "--trajectory", "{recording}"], "same file"),
        (["map", "{recording}", "-o", "{tmp}/x.nc", "--trajectory", "{tmp}/x.nc"], "same file"),
        (["odometry", "{recording}", "-o", "{recording}"], "same file"),
        (["odometry", "{recording}", "-o", "{tmp}/x.mcap"], "another name for a TUM file"),
        (["map", "{tmp}", "-o", "{tmp}/x.nc"], "`terravibe import` makes one"),
        (["info", "{tmp}"], "is no world map"),
        (["map", "{recording}", "-o", "{tmp}/x.nc", "--mount-sigma-m", "-1"], "mount_sigma_m"),
        (
            ["map", "{recording}", "-o", "{tmp}/x.nc", "--mount-sigma-deg", "-3"],
            "--mount-sigma-deg is -3.0",
        ),
        (["map", "{recording}", "-o", "{tmp}/x.nc", "--fill-gaps-up-to-m", "9"], "64 cells"),
        (["export", "{recording}"], "nothing to do"),
        (["export", "{recording}", "-o", "{tmp}/x.tif"], "NetCDF"),
        (["evaluate", "{tmp}/none.nc", "--floor-height-m", "0"], "none.nc"),
        (["import", "tum", "{tmp}", "--intrinsics", "1,1,1,1", "-o", "{tmp}/y.mcap"], "depth.txt"),
        (
            ["import", "tum", "{tmp}", "--intrinsics=1,1,1,1", "--pose-sigma-deg=0", "-oy.mcap"],
            "--pose-sigma-deg is 0.0",
        ),
        (["recover", "{recording}", "-o", "{recording}"], "exists already; give another name"),
        (["cut", "{recording}", "-o", "{recording}"], "exists already; give another name"),
        (["merge", "{recording}", "x", "-o", "{recording}"], "exists already; give another name"),
        (["demo", "--seconds", "0"], "4 to 3600 s"),
        (["demo", "--seed", "-1"], "seed"),
        (["simulate", "moon", "-o", "{tmp}/r.mcap", "--truth", "{tmp}/t.nc"], "simulation, smooth"),
        (
            ["simulate", "indoor", "-o", "{tmp}/r.mcap", "--truth", "{tmp}/t.nc", "--seconds", "1"],
            "4 to 3600 s",
        ),
        (
            ["simulate", "indoor", "-o", "{tmp}/r.mcap", "--truth", "{tmp}/t.nc", "--seed", "-1"],
            "seed -1",
        ),
        (["simulate", "indoor", "-o", "{tmp}/r.mcap", "--truth", "{tmp}/no/t.nc"], "no folder"),
    ],
)
def test_unusable_input_is_one_line_and_exit_2(
    arguments: list[str],
    words: str,
    recording: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    for told_to_compile in ("kernels_are_cached", "filter_is_cached"):  # not before it is checked
        monkeypatch.setattr(kernel_cache, told_to_compile, lambda: False)
    before = set(tmp_path.rglob("*"))
    capsys.readouterr()
    filled = [a.format(recording=recording, tmp=tmp_path) for a in arguments]
    assert cli.main(filled) == _UNUSABLE
    error = capsys.readouterr().err.strip()
    assert len(error.splitlines()) == 1
    assert words in error
    assert set(tmp_path.rglob("*")) <= before


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["nonsense"],
        ["map"],
        ["map", "x.mcap", "-o", "x.tif"],
        ["map", "x.mcap", "-o", "x.nc", "--reorder-window-s", "nan"],
        ["import", "tum", "x", "--intrinsics", "1,2", "-o", "y.mcap"],
        ["simulate", "indoor", "-o", "r.mcap", "--truth", "r.mcap"],
        ["cut", "x.mcap", "-o", "y.mcap", "--topics", "/gyro,"],
        ["cut", "x.mcap", "-o", "y.mcap", "--start-s", "1e300"],
    ],
)
def test_wrong_usage_is_one_line_and_exit_2(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        cli.main(arguments)
    assert stop.value.code == _UNUSABLE
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_command_that_is_ended_leaves_nothing_half_written(
    number: signal.Signals,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path, output = tmp_path / "a.mcap", tmp_path / "b.mcap"
    path.write_bytes(sound_recording([pose(0)]))

    def end_the_program(_copy: object, _name: str, _record: object) -> None:
        assert len(list(tmp_path.iterdir())) == 2  # one of them has a hidden name
        signal.raise_signal(number)

    monkeypatch.setattr(RecordingCopy, "metadata", end_the_program)
    assert cli.main(["cut", str(path), "-o", str(output)]) == 130
    assert capsys.readouterr().err == "terravibe: interrupted; no file is left half-written\n"
    assert list(tmp_path.iterdir()) == [path]
    assert signal.getsignal(signal.SIGTERM) is signal.getsignal(signal.SIGHUP) is signal.SIG_DFL


def test_a_terminal_that_cannot_redraw_gets_lines(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with cli.Terminal().board() as show:
        show(lambda: "a picture", lambda: ["a line"])
    assert capsys.readouterr().err == "terravibe: a line\n"


def test_shadowed_room_is_refused(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import drivers

    monkeypatch.setattr(drivers, "DISTRIBUTION", "somebody-elses")
    assert cli.main(["--help"]) == _UNUSABLE
    assert "another distribution" in capsys.readouterr().err


def test_an_installation_without_a_room_says_what_to_do(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cli, "_ROOMS", ("drivers", "attic"))
    assert cli.main(["--help"]) == _UNUSABLE
    assert "No module named 'attic'; this installation is older" in capsys.readouterr().err


def test_rooms_never_import_the_command_line_nor_print() -> None:
    for room in ("drivers", "acquisition", "mapping", "calibration_rigs", "simulation"):
        for path in (_ROOT / room).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Import):
                    assert "cli" not in [alias.name for alias in node.names], path
                if isinstance(node, ast.ImportFrom):
                    assert node.module != "cli", path
                if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                    assert node.func.id != "print", path


def test_every_package_is_installed() -> None:
    listed = tomllib.loads((_ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    rooms = {name.split(".")[0] for name in listed}
    found = [
        p.parent.relative_to(_ROOT) for room in rooms for p in (_ROOT / room).rglob("__init__.py")
    ]
    assert sorted(listed) == sorted(".".join(folder.parts) for folder in found)
