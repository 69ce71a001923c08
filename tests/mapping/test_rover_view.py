"""Ranges, and errors relative to the rover's true pose: planes whose answers are known."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drivers.depth.trajectory import Trajectory
from mapping.cells.elevation_map import ElevationMap
from mapping.errors import MappingError
from mapping.geometry import RigidTransform
from mapping.judging.evaluation import Scores
from mapping.judging.rover_view import seen_from_m
from mapping.judging.truth import Truth, evaluate_truth, read_truth, write_truth
from mapping.output.figure_scores import scores_figure
from tests.mapping.maps import EPOCH_NS, make_map

SLOPE = np.array([0.1, -0.2])
STEP_NS = 1_000_000_000


def track(*poses: RigidTransform, start_ns: int = EPOCH_NS) -> Trajectory:
    """Return poses one second apart."""
    quats = Rotation.from_matrix(np.stack([pose.rotation for pose in poses])).as_quat()
    positions = np.stack([pose.translation_m for pose in poses])
    t_ns = start_ns + STEP_NS * np.arange(len(poses), dtype=np.int64)
    return Trajectory(Path("track.txt"), t_ns, positions, quats)


def at(x_m: float, y_m: float, *, tilt_rad: float = 0.0, z_m: float = 0.0) -> RigidTransform:
    rotation = Rotation.from_rotvec([tilt_rad, -tilt_rad, 5.0 * tilt_rad]).as_matrix()
    return RigidTransform(rotation, np.array([x_m, y_m, z_m]))


def plane_truth(poses: Trajectory | None, step: float = 0.0) -> Truth:
    """Return an inclined plane; it jumps by `step` beyond x = 1."""
    axis = np.linspace(-5.0, 5.0, 201, dtype=np.float64)
    height = SLOPE[0] * axis + SLOPE[1] * axis[:, np.newaxis] + step * (axis > 1.0)
    return Truth(axis, axis, height, None, poses)


def plane_map(displaced: RigidTransform, bump_m: float = 0.0) -> ElevationMap:
    """Return a map of that plane in a frame in which everything is displaced."""
    normal = displaced.rotation @ np.array([-SLOPE[0], -SLOPE[1], 1.0])
    x, y = np.meshgrid(0.04 * (np.arange(-40, 41) + 0.5), 0.04 * (np.arange(-30, 31) + 0.5))
    dx, dy = x - displaced.translation_m[0], y - displaced.translation_m[1]
    height = displaced.translation_m[2] - (normal[0] * dx + normal[1] * dy) / normal[2]
    return make_map(height + bump_m, sigma_m=0.01, first_x=-40, first_y=-30)


drift_m = st.floats(-0.3, 0.3)


@settings(max_examples=15, deadline=None)
@given(x=drift_m, y=drift_m, z=drift_m, tilt=st.floats(-0.03, 0.03))
def test_what_moves_map_and_poses_alike_is_no_error_to_the_rover(
    x: float, y: float, z: float, tilt: float
) -> None:
    pose = at(0.2, -0.1, tilt_rad=0.05, z_m=0.4)
    drift = at(x, y, tilt_rad=tilt, z_m=z)
    scores = evaluate_truth(
        plane_map(drift), plane_truth(track(pose)), believed=track(drift @ pose)
    )
    for part in scores.relative.values():
        assert part.cells > 1000
        assert part.max_m < 1e-6  # heights are float32
        assert part.coverage_1sigma == 1.0


def test_with_true_poses_the_world_and_the_rover_agree() -> None:
    truth = plane_truth(track(at(0.0, 0.0)), step=0.2)
    scores = evaluate_truth(plane_map(at(0.0, 0.0), bump_m=0.004), truth)
    seen = scores.relative["when_seen"]
    assert seen == scores.relative["at_end"]
    assert seen.cells > 1000
    # Beyond the jump the map is 0.2 m too low; beside it are edges, which are apart.
    assert 0 < seen.edges.cells < 300
    assert seen.cells == scores.cells
    assert seen.rmse_m == pytest.approx(scores.rmse_m, rel=1e-6)
    assert seen.by_slope.keys() == scores.by_slope.keys()
    assert seen.by_slope["10-20 deg"].cells == scores.by_slope["10-20 deg"].cells > 0


def test_a_drift_counts_from_when_a_cell_was_last_seen() -> None:
    map_ = plane_map(at(0.0, 0.0))
    last_seen = np.where(map_.x_m < 0.0, EPOCH_NS, EPOCH_NS + STEP_NS)
    map_ = replace(map_, last_seen_ns=np.broadcast_to(last_seen, map_.state.shape))
    rover, sunk = at(0.0, 0.0), at(0.0, 0.0, z_m=-0.05)
    # At first the believed pose is right; in the end it is 5 cm too low.
    scores = evaluate_truth(map_, plane_truth(track(rover, rover)), believed=track(rover, sunk))
    at_end = scores.relative["at_end"]
    assert at_end.bias_m == pytest.approx(0.05, abs=1e-6)
    assert scores.relative["when_seen"].bias_m == pytest.approx(0.05 * 41 / 81, abs=0.001)
    assert scores.bias_m == pytest.approx(0.0, abs=1e-6)


def test_far_and_weak_cells_are_not_judged_from_the_rover() -> None:
    map_ = make_map(np.zeros((1, 200)), first_x=0, first_y=0)
    frames, pixels = map_.frames.copy(), map_.pixels.copy()
    frames[0, 0], pixels[0, 1] = 1, 3
    map_ = replace(map_, frames=frames, pixels=pixels)
    scores = evaluate_truth(map_, plane_truth(track(at(0.0, 0.02))))
    # Cell centres at 0.02, 0.06 ... 2.98 m but for two.
    assert scores.relative["when_seen"].cells == 75 - 2
    assert scores.cells == 125  # the truth ends at 5 m


def test_ranges_are_horizontal_and_from_where_each_cell_was_last_seen() -> None:
    map_ = make_map([[0.0, 0.0, np.nan, 0.0]], resolution_m=1.0, first_x=0, first_y=0)
    times = np.array([[EPOCH_NS, EPOCH_NS + STEP_NS, 0, EPOCH_NS + 9 * STEP_NS]])
    believed = track(at(0.5, 3.5, z_m=7.0), at(4.5, 4.5))
    range_m = seen_from_m(replace(map_, last_seen_ns=times), believed)
    np.testing.assert_allclose(range_m, [[3.0, 5.0, np.nan, np.nan]])


def judged() -> Scores:
    return evaluate_truth(plane_map(at(0.0, 0.0), 0.004), plane_truth(track(at(0.0, 0.0))))


def test_scores_hold_the_promised_parts() -> None:
    scores = judged()
    found = json.loads(json.dumps(scores.as_json(), allow_nan=False))
    numbers = list(found)[:11]
    for part in (found, *found["relative"].values()):
        assert list(part)[:11] == numbers
        assert list(part["by_range"]) == ["0-1 m", "1-1.5 m", "1.5-2 m", "2-3 m", ">=3 m"]
        assert sum(row["cells"] for row in part["by_range"].values()) == part["cells"]
        assert {"by_slope", "edges"} <= part.keys()
    assert list(found["relative"]) == ["when_seen", "at_end"]
    assert any(line.startswith("rover when seen ") for line in scores.describe())
    assert any(line.startswith("range 1-1.5 m ") for line in scores.describe())


def test_bars_show_slope_and_range() -> None:
    figure = scores_figure(judged())
    assert figure is not None
    labels = [axes.get_xlabel() for axes in figure.axes]
    assert "slope of the true terrain" in labels
    assert "horizontal distance from the rover when last seen" in labels
    map_ = make_map([[0.0]], first_x=0, first_y=0)
    assert scores_figure(evaluate_truth(map_, Truth(map_.x_m, map_.y_m, np.zeros((1, 1))))) is None


def test_trajectories_that_do_not_belong_to_the_map_are_refused() -> None:
    map_, later = plane_map(at(0.0, 0.0)), track(at(0.0, 0.0), start_ns=EPOCH_NS + STEP_NS)
    with pytest.raises(MappingError, match="holds no pose at a time of the map"):
        evaluate_truth(map_, plane_truth(track(at(0.0, 0.0))), believed=later)
    with pytest.raises(MappingError, match=r"no poses to compare track\.txt with"):
        evaluate_truth(map_, plane_truth(None), believed=later)
    # A truth of another run says nothing about ranges.
    scores = evaluate_truth(map_, plane_truth(later))
    assert scores.cells > 0
    assert scores.relative["when_seen"].cells == 0
    assert all(part.cells == 0 for part in scores.by_range.values())


def with_poses(path: Path, components: int) -> None:
    """Write a truth with the poses of a simulated run's."""
    write_truth(path, plane_truth(None))
    dataset = xr.load_dataset(path)
    dataset["position"] = (("position_time", "c"), np.array([[1.0, 2.0, 3.0]])[:, :components])
    dataset["quat_wxyz"] = (("position_time", "q"), np.array([[0.5, -0.5, 0.5, 0.5]]))
    times = ("position_time", np.array([EPOCH_NS]), {"units": "nanoseconds since 1970-01-01"})
    dataset.assign_coords(position_time=times).to_netcdf(path, engine="h5netcdf")


def test_poses_in_a_truth_file_are_read(tmp_path: Path) -> None:
    path = tmp_path / "truth.nc"
    with_poses(path, 3)
    poses = read_truth(path).poses
    assert poses is not None
    assert poses.t_ns.tolist() == [EPOCH_NS]
    assert poses.position_m.tolist() == [[1.0, 2.0, 3.0]]
    assert poses.quat_xyzw.tolist() == [[-0.5, 0.5, 0.5, 0.5]]
    with_poses(path, 2)
    with pytest.raises(MappingError, match="poses of shape"):
        read_truth(path)
