"""The truth brought to a map's cells, and its file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from mapping.errors import MappingError
from mapping.judging.truth import Truth, evaluate_truth, read_truth, write_truth
from tests.mapping.maps import hilly_map, make_map


def _plane(step_m: float = 0.05, count: int = 41) -> Truth:
    """Return z = 0.3 x - 0.2 y + 1 on a grid about the origin, with a hidden half."""
    axis = step_m * np.arange(-(count // 2), count // 2 + 1, dtype=np.float64)
    x, y = np.meshgrid(axis, axis)
    return Truth(axis, axis, 0.3 * x - 0.2 * y + 1.0, x < 0.0)


def test_equal_grids_are_exact_to_the_bit_even_beside_gaps() -> None:
    map_ = hilly_map()
    truth = Truth(map_.x_m, map_.y_m, map_.elevation_m.astype(np.float64))
    np.testing.assert_array_equal(truth.truth_at(map_).height_m, truth.height_m)


def test_a_plane_is_a_plane_between_the_points() -> None:
    map_ = make_map(np.zeros((6, 7)))
    here = _plane().truth_at(map_)
    x, y = np.meshgrid(map_.x_m, map_.y_m)
    np.testing.assert_allclose(here.height_m, 0.3 * x - 0.2 * y + 1.0, atol=1e-12)
    assert here.visible is not None
    assert here.visible[:, 0].all()
    assert not here.visible[:, -1].any()


def test_outside_and_beside_gaps_there_is_no_truth() -> None:
    truth = Truth(
        np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0]), np.array([[0, 1, 2], [0, 1, np.nan]])
    )
    map_ = make_map(np.zeros((1, 4)), resolution_m=1.0, first_x=-1, first_y=0)
    np.testing.assert_array_equal(truth.truth_at(map_).height_m, [[np.nan, 0.5, np.nan, np.nan]])


def test_one_row_of_truth_holds_for_that_row_only() -> None:
    truth = Truth(np.array([0.0, 1.0]), np.array([0.5]), np.array([[1.0, 3.0]]))
    map_ = make_map(np.zeros((2, 1)), resolution_m=1.0, first_x=0, first_y=0)
    np.testing.assert_array_equal(truth.truth_at(map_).height_m, [[2.0], [np.nan]])


def test_visible_ground_beyond_the_map_lowers_its_completeness() -> None:
    truth = _plane(step_m=0.04, count=101)
    truth = Truth(truth.x_m + 0.02, truth.y_m + 0.02, truth.height_m, np.ones((101, 101), bool))
    map_ = make_map(np.zeros((10, 20)))
    assert truth.visible_outside(map_) == pytest.approx(101 * 101 - 200)
    assert evaluate_truth(map_, truth).completeness == pytest.approx(200 / 101**2)
    fine = _plane(step_m=0.02, count=201)
    fine = Truth(fine.x_m, fine.y_m, fine.height_m, np.ones((201, 201), bool))
    expected_cells = 201**2 / 4 - 200
    assert fine.visible_outside(map_) == pytest.approx(expected_cells, rel=0.01)


def test_without_a_mask_nothing_is_missed() -> None:
    truth = _plane()
    assert Truth(truth.x_m, truth.y_m, truth.height_m).visible_outside(make_map([[0.0]])) == 0.0


@pytest.mark.parametrize("mask", [True, False])
def test_a_truth_comes_back_bit_for_bit(tmp_path: Path, mask: bool) -> None:
    truth = _plane()
    if not mask:
        truth = Truth(truth.x_m, truth.y_m, truth.height_m)
    truth.height_m[3, 4] = np.nan
    write_truth(tmp_path / "truth.nc", truth)
    again = read_truth(tmp_path / "truth.nc")
    for name in ("x_m", "y_m", "height_m", "visible"):
        np.testing.assert_array_equal(getattr(again, name), getattr(truth, name))
    with xr.open_dataset(tmp_path / "truth.nc") as dataset:
        assert dataset["height"].attrs["units"] == "m"


def test_a_truth_with_its_axes_the_other_way_round_is_understood(tmp_path: Path) -> None:
    heights = np.arange(6.0).reshape(2, 3)
    xr.Dataset(
        {"height": (("x", "y"), heights.T)}, {"x": [0.0, 1.0, 2.0], "y": [0.0, 1.0]}
    ).to_netcdf(tmp_path / "truth.nc", engine="h5netcdf")
    np.testing.assert_array_equal(read_truth(tmp_path / "truth.nc").height_m, heights)


@pytest.mark.parametrize(
    ("dataset", "reason"),
    [
        (xr.Dataset({"z": ("x", [1.0])}, {"x": [0.0]}), "'y'"),
        (xr.Dataset({"height": ("x", [1.0])}, {"x": [0.0], "y": [0.0]}), "'y'"),
        (
            xr.Dataset({"height": (("y", "x"), [[1.0, 2.0]])}, {"x": [1.0, 0.0], "y": [0.0]}),
            "must increase",
        ),
    ],
)
def test_a_file_without_a_truth_is_refused(
    tmp_path: Path, dataset: xr.Dataset, reason: str
) -> None:
    dataset.to_netcdf(tmp_path / "t.nc", engine="h5netcdf")
    with pytest.raises(MappingError, match=rf"t\.nc holds no truth \(.*{reason}.*\); expected x"):
        read_truth(tmp_path / "t.nc")


def test_grids_that_do_not_fit_are_refused() -> None:
    axis = np.array([0.0, 1.0])
    with pytest.raises(MappingError, match=r"shape \(2, 3\); expected \(2, 2\)"):
        Truth(axis, axis, np.zeros((2, 3)))
    with pytest.raises(MappingError, match="visible mask"):
        Truth(axis, axis, np.zeros((2, 2)), np.zeros((1, 2), bool))
