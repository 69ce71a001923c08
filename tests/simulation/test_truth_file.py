import errno
import os
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from mapping.judging.truth import read_truth
from simulation.errors import SimulationError
from simulation.terrain.height_grid import HeightGrid
from simulation.truth import Truth
from simulation.truth_file import Signal, pose_signals, write_truth_file

T_NS = np.array([5, 1_767_225_600_000_000_007, 1_767_225_600_100_000_007])


def some_truth() -> Truth:
    heights = np.random.default_rng(0).normal(size=(3, 4))
    return Truth(
        np.array([0.0, 0.04, 0.08, 0.12]), np.array([0.0, 0.04, 0.08]), heights, heights > 0.0
    )


def some_ground() -> HeightGrid:
    return HeightGrid(-1.0, 2.0, 0.5, np.arange(12, dtype=np.float32).reshape(4, 3))


def write(path: Path, **signals: Signal) -> None:
    write_truth_file(path, some_truth(), some_ground(), signals)


def test_the_evaluation_reads_what_was_written(tmp_path: Path) -> None:
    write(tmp_path / "truth.nc")
    found, wanted = read_truth(tmp_path / "truth.nc"), some_truth()
    np.testing.assert_array_equal(found.x_m, wanted.x_m)
    np.testing.assert_array_equal(found.y_m, wanted.y_m)
    np.testing.assert_array_equal(found.height_m, wanted.height_m)
    assert found.visible is not None
    np.testing.assert_array_equal(found.visible, wanted.visible)


def test_facts_about_the_run_are_attributes(tmp_path: Path) -> None:
    facts: dict[str, str | float] = {"scenario": "rough", "stuck_s": 1.5}
    write_truth_file(tmp_path / "truth.nc", some_truth(), some_ground(), {}, facts)
    with xr.open_dataset(tmp_path / "truth.nc", engine="h5netcdf") as dataset:
        assert (dataset.attrs["run_scenario"], dataset.attrs["run_stuck_s"]) == ("rough", 1.5)


def test_ground_poses_and_signals_come_back(tmp_path: Path) -> None:
    positions, quats = np.arange(9.0).reshape(3, 3), np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
    rate = Signal(T_NS[:2], np.array([0.1, -0.2]), "rad s-1", "yaw rate of the body")
    write(tmp_path / "truth.nc", yaw_rate=rate, **pose_signals(T_NS, positions, quats))
    with xr.open_dataset(tmp_path / "truth.nc", engine="h5netcdf", decode_cf=False) as dataset:
        dataset.load()
    np.testing.assert_array_equal(dataset["ground_height"], some_ground().height_m)
    np.testing.assert_array_equal(dataset["ground_y"], some_ground().y_m)
    np.testing.assert_array_equal(dataset["position"], positions)
    np.testing.assert_array_equal(dataset["quat_wxyz"], quats)
    np.testing.assert_array_equal(dataset["position_time"], T_NS)
    assert dataset["yaw_rate"].attrs == {"units": "rad s-1", "long_name": "yaw rate of the body"}
    assert dataset["yaw_rate"].dims == ("yaw_rate_time",)


def test_times_are_instants_for_other_readers(tmp_path: Path) -> None:
    write(tmp_path / "truth.nc", speed=Signal(T_NS, np.zeros(3), "m s-1", "speed"))
    with xr.open_dataset(tmp_path / "truth.nc", engine="h5netcdf") as dataset:
        assert dataset["speed_time"].values.astype("datetime64[ns]").tolist() == T_NS.tolist()


def test_equal_truths_give_equal_bytes(tmp_path: Path) -> None:
    for name in ("a.nc", "b.nc"):
        write(tmp_path / name, speed=Signal(T_NS, np.zeros(3), "m s-1", "speed"))
    assert (tmp_path / "a.nc").read_bytes() == (tmp_path / "b.nc").read_bytes()


@pytest.mark.parametrize("name", ["height", "ground_x", "y"])
def test_names_of_the_terrain_are_taken(tmp_path: Path, name: str) -> None:
    with pytest.raises(SimulationError, match="is taken"):
        write(tmp_path / "truth.nc", **{name: Signal(T_NS, np.zeros(3), "1", "speed")})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("shape", [(2,), (3, 2, 2), ()])
def test_values_must_belong_to_times(shape: tuple[int, ...]) -> None:
    with pytest.raises(SimulationError, match="speed"):
        Signal(T_NS, np.zeros(shape), "m s-1", "speed")


def test_a_full_disk_leaves_the_older_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    (tmp_path / "truth.nc").write_text("older")
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(SimulationError, match="No space left on device"):
        write(tmp_path / "truth.nc")
    assert [path.name for path in tmp_path.iterdir()] == ["truth.nc"]
    assert (tmp_path / "truth.nc").read_text() == "older"


def test_impossible_places_are_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    for path in (tmp_path / "no" / "t.nc", tmp_path / "file" / "t.nc", tmp_path / "folder"):
        with pytest.raises(SimulationError, match="cannot write"):
            write(path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder"]
