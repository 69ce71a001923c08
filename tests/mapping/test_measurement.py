"""The pixel kernels against a slow oracle: heights, weights, cells, sums, and what is left out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from drivers.samples import CameraIntrinsics
from mapping import measurement_kernels as kernels
from mapping.errors import MappingError
from mapping.grid import CellWindow
from mapping.measurement import FrameReducer, View, _view_constants
from mapping.noise import KINECT_QUANTISATION, KINECT_V1, NGUYEN_2012, DepthNoiseModel
from mapping.settings import MapSettings
from tests.mapping import oracle
from tests.mapping.scenes import CAMERA, looking, millimetres, plane_z, view_of

Float64Array = NDArray[np.float64]

# Pixels of a quarter of a Kinect's width: +-1 px is a third of the angle that the real one takes.
FINE = CameraIntrinsics(160, 60, 145.0, 147.0, 78.2, 31.0)
CELL_M = 0.04
FLOOR = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Pixels:
    """What the row kernel says of every pixel; a cell is -1 or its number in the window."""

    height_m: NDArray[np.float32]
    weight: NDArray[np.float32]
    cell: NDArray[np.int32]


def _measure(reducer: FrameReducer, z_m: Float64Array, view: View, window: CellWindow) -> Pixels:
    """Run the row kernel over exact distances, without millimetres in between."""
    k = reducer._baseline_px
    reducer._z_m[k:-k, k:-k] = z_m
    height, weight = np.empty(z_m.shape, np.float32), np.empty(z_m.shape, np.float32)
    cell = np.empty(z_m.shape, np.int32)
    camera = reducer.camera
    focal = kernels.FocalConstants(
        np.float32(camera.fx_px),
        np.float32(camera.fy_px),
        np.float32(camera.width_px / (640.0 * camera.fx_px)),
    )
    constants = _view_constants(view, window, CELL_M)
    for v in range(z_m.shape[0]):
        kernels.measure_row(
            reducer._z_m[v],
            reducer._z_m[v + k],
            reducer._z_m[v + 2 * k],
            k,
            reducer._ray_x,
            reducer._ray_y[v],
            focal,
            reducer._noise_constants,
            constants,
            height[v],
            weight[v],
            cell[v],
        )
    return Pixels(height, weight, cell)


def _reducer(
    camera: CameraIntrinsics = CAMERA, noise: DepthNoiseModel = NGUYEN_2012
) -> FrameReducer:
    return FrameReducer(camera, noise, MapSettings(resolution_m=CELL_M))


def _number(cells: NDArray[np.int64], window: CellWindow) -> NDArray[np.int64]:
    """Return the number in the window of global cells (..., 2), -1 outside."""
    column, row = cells[..., 0] - window.first_x, cells[..., 1] - window.first_y
    inside = (column >= 0) & (column < window.cells_x) & (row >= 0) & (row < window.cells_y)
    return np.where(inside, row * window.cells_x + column, -1)


def _surrounded(z_m: Float64Array) -> NDArray[np.bool_]:
    """Return the pixels that have readings on all four sides."""
    p = np.pad(z_m, 1) > 0.0
    inner = p[1:-1, 1:-1] & p[1:-1, 2:] & p[1:-1, :-2]
    surrounded: NDArray[np.bool_] = inner & p[2:, 1:-1] & p[:-2, 1:-1]
    return surrounded


@pytest.mark.parametrize("noise", [NGUYEN_2012, KINECT_QUANTISATION], ids=lambda n: n.name)
@pytest.mark.parametrize(
    ("yaw", "pitch", "roll", "normal", "distance_m"),
    [
        (0.0, 25.0, 0.0, FLOOR, -0.4),
        (130.0, 40.0, 5.0, FLOOR, -0.8),
        (-75.0, 90.0, 0.0, FLOOR, -1.5),
        (20.0, 60.0, -20.0, (-0.3, 0.1, 1.0), -0.9),
        (0.0, 45.0, 45.0, (0.5, 0.4, 1.0), -0.9),
        (0.0, 0.0, 0.0, (-1.0, 0.0, 0.0), -2.0),  # a wall
        (45.0, -5.0, 3.0, (-1.0, -1.0, 0.2), -2.5),
        (10.0, -70.0, 0.0, FLOOR, 1.5),  # a ceiling
        (200.0, 85.0, 90.0, (0.2, -0.3, 1.0), -1.1),
    ],
)
def test_planes_are_measured_as_the_formulas_say(
    noise: DepthNoiseModel,
    yaw: float,
    pitch: float,
    roll: float,
    normal: tuple[float, float, float],
    distance_m: float,
) -> None:
    view = view_of(looking(yaw, pitch, roll), (12.34, -5.67, 3.0))
    rotation = view.T_terrain_sensor.rotation
    z_m = plane_z(FINE, rotation, normal, distance_m)
    z_m[(z_m < 0.4) | (z_m > 4.0)] = 0.0
    incidence = oracle.plane_incidence(FINE, rotation, normal)
    expected = oracle.measure(z_m, incidence, FINE, noise, view, CELL_M)
    reducer = _reducer(FINE, noise)
    window = reducer.footprint(view)
    found = _measure(reducer, z_m, view, window)

    valid = expected.valid
    assert valid.mean() > 0.2
    np.testing.assert_array_equal(found.cell >= 0, valid)
    np.testing.assert_allclose(found.height_m[valid], expected.height_m[valid], atol=4e-6)
    sure = valid & expected.off_borders(1e-3)
    numbers = _number(expected.cell, window)
    np.testing.assert_array_equal(found.cell[sure], numbers[sure])
    # The difference quotient bends where a row grazes.
    clear = _surrounded(z_m) & (incidence < np.radians(80.0))
    assert clear.mean() > 0.15
    wanted = np.maximum(expected.variance_m2, 1e-10)
    np.testing.assert_allclose(1.0 / found.weight[clear], wanted[clear], rtol=0.02)


def test_the_angle_counts_in_the_weight() -> None:
    """The tolerance of the test above would not notice a wrong angle where it hardly counts."""
    noise = DepthNoiseModel("angle", axial_offset_m=1e-4, axial_angle_m_sqrt_m=0.01)
    view = view_of(looking(0.0, 35.0))
    z_m = plane_z(FINE, view.T_terrain_sensor.rotation, FLOOR, -1.0)
    z_m[z_m > 4.0] = 0.0
    incidence = oracle.plane_incidence(FINE, view.T_terrain_sensor.rotation, FLOOR)
    expected = oracle.measure(z_m, incidence, FINE, noise, view, CELL_M)
    reducer = _reducer(FINE, noise)
    found = _measure(reducer, z_m, view, reducer.footprint(view))
    clear = _surrounded(z_m) & (incidence > np.radians(30.0)) & (incidence < np.radians(70.0))
    assert clear.sum() > 5000
    relative = 1.0 / found.weight[clear] / expected.variance_m2[clear]
    np.testing.assert_allclose(relative, 1.0, atol=0.02)


def test_a_reading_alone_is_taken_as_facing_the_camera() -> None:
    view = view_of(looking(0.0, 50.0))
    z_m = np.zeros((CAMERA.height_px, CAMERA.width_px))
    z_m[::4, ::4] = 1.3
    n = view.T_terrain_sensor.rotation[:, 2]
    incidence = oracle.plane_incidence(CAMERA, view.T_terrain_sensor.rotation, n)
    expected = oracle.measure(z_m, incidence, CAMERA, NGUYEN_2012, view, CELL_M)
    reducer = _reducer()
    found = _measure(reducer, z_m, view, reducer.footprint(view))
    np.testing.assert_array_equal(found.cell >= 0, z_m > 0.0)
    seen = z_m > 0.0
    np.testing.assert_allclose(1.0 / found.weight[seen], expected.variance_m2[seen], rtol=2e-5)


def test_beside_holes_and_at_the_image_border_the_gradient_is_one_sided() -> None:
    view = view_of(looking(0.0, 50.0))
    rotation = view.T_terrain_sensor.rotation
    whole = plane_z(FINE, rotation, FLOOR, -1.0)
    z_m = np.where(np.random.default_rng(1).random(whole.shape) < 0.3, 0.0, whole)
    incidence = oracle.plane_incidence(FINE, rotation, FLOOR)
    noise = DepthNoiseModel("angle", axial_offset_m=1e-4, axial_angle_m_sqrt_m=0.01)
    expected = oracle.measure(z_m, incidence, FINE, noise, view, CELL_M)
    reducer = _reducer(FINE, noise)
    found = _measure(reducer, z_m, view, reducer.footprint(view))
    np.testing.assert_array_equal(found.cell >= 0, z_m > 0.0)
    has_neighbours = np.ones(z_m.shape, bool)
    padded = np.pad(z_m, 1)
    has_neighbours &= (padded[1:-1, 2:] > 0.0) | (padded[1:-1, :-2] > 0.0)
    has_neighbours &= (padded[2:, 1:-1] > 0.0) | (padded[:-2, 1:-1] > 0.0)
    clear = (z_m > 0.0) & has_neighbours
    assert clear[0].any()
    assert clear[:, -1].any()
    relative = 1.0 / found.weight[clear] / expected.variance_m2[clear]
    # One-sided: first order in the pixel's angle.
    np.testing.assert_allclose(relative, 1.0, atol=0.06)


def test_an_edge_lowers_the_weight_of_its_pixels() -> None:
    view = view_of(looking(0.0, 50.0))
    z_m = np.full((CAMERA.height_px, CAMERA.width_px), 1.0)
    z_m[:, 32:] = 1.8
    reducer = _reducer()
    found = _measure(reducer, z_m, view, reducer.footprint(view))
    inner = found.weight[20, 20:31]
    assert found.weight[20, 31] < 0.2 * inner.min()
    assert found.weight[20, 32] < 0.2 * found.weight[20, 34]


def test_a_level_ray_has_a_finite_weight() -> None:
    noise = DepthNoiseModel("axial", axial_offset_m=0.001)
    reducer = _reducer(replace(CAMERA, cy_px=24.0), noise)
    view = view_of(looking(0.0, 0.0))
    z_m = np.full((CAMERA.height_px, CAMERA.width_px), 2.0)
    found = _measure(reducer, z_m, view, reducer.footprint(view))
    assert np.isfinite(found.weight).all()
    assert found.weight[24].max() == np.float32(1e10)


@pytest.mark.parametrize("position_m", [(0.0, 0.0, 0.0), (1e4, -1e4, 5e3), (5e5, 5e6, -100.0)])
def test_far_from_the_origin_the_same_points_go_to_the_same_cells(
    position_m: tuple[float, float, float],
) -> None:
    """Positions are whole numbers of cells, so the window moves along and nothing else changes."""
    here = view_of(looking(30.0, 40.0), (0.0, 0.0, 0.0))
    there = view_of(looking(30.0, 40.0), position_m)
    z_m = plane_z(CAMERA, here.T_terrain_sensor.rotation, FLOOR, -0.8)
    z_m[z_m > 4.0] = 0.0
    reducer = _reducer()
    window = reducer.footprint(here)
    first = _measure(reducer, z_m, here, window)
    moved = reducer.footprint(there)
    assert (moved.cells_x, moved.cells_y) == (window.cells_x, window.cells_y)
    assert moved.first_x - window.first_x == round(position_m[0] / CELL_M)
    second = _measure(reducer, z_m, there, moved)
    same = first.cell == second.cell
    assert same.mean() > 0.999  # the position in cells is rounded in its tenth digit
    np.testing.assert_array_equal(first.height_m, second.height_m)


def test_limits_of_the_range_belong_to_it() -> None:
    for limit_mm in range(500, 9000, 100):
        limit_m = limit_mm / 1000.0
        reducer = _reducer(noise=NGUYEN_2012.with_range(0.4, limit_m))
        depth = np.zeros((CAMERA.height_px, CAMERA.width_px), np.uint16)
        depth[3, :4] = (limit_mm, limit_mm + 1, 400, 399)
        assert reducer.load(depth) == 2, limit_m
        kept = reducer._z_m[3 + reducer._baseline_px, reducer._baseline_px :][:4]
        np.testing.assert_array_equal(kept, np.array([limit_m, 0.0, 0.4, 0.0], np.float32))


def test_the_bias_is_taken_off_before_the_limits_apply() -> None:
    noise = replace(
        NGUYEN_2012, bias_m=0.01, bias_slope=-0.02, bias_quadratic_per_m=0.003, range_max_m=3.0
    )
    reducer = _reducer(noise=noise)
    depth = np.zeros((CAMERA.height_px, CAMERA.width_px), np.uint16)
    depth[0, :3] = (2000, 2975, 2980)
    # 2 - (0.01 - 0.04 + 0.012); 2.975 becomes 2.9979, 2.98 becomes 3.003.
    assert reducer.load(depth) == 2
    k = reducer._baseline_px
    assert reducer._z_m[k, k] == pytest.approx(2.018, abs=1e-6)
    assert reducer._z_m[k, k + 2] == 0.0


def test_no_return_and_the_largest_number_are_left_out() -> None:
    reducer = _reducer()
    depth = np.full((CAMERA.height_px, CAMERA.width_px), 65535, np.uint16)
    depth[::2] = 0
    assert reducer.load(depth) == 0


@pytest.mark.parametrize(
    "depth",
    [
        np.zeros((48, 65), np.uint16),
        np.zeros((480, 640), np.uint16),
        np.zeros((48, 64), np.float32),
        np.zeros((64, 48), np.uint16),
        np.zeros(48 * 64, np.uint16),
    ],
)
def test_an_image_that_does_not_fit_its_camera_is_refused(depth: NDArray[np.uint16]) -> None:
    with pytest.raises(MappingError, match=r"its camera expects uint16 of shape \(48, 64\)"):
        _reducer().load(depth)


def _loaded(view: View, height_m: float = 0.8) -> tuple[FrameReducer, Float64Array]:
    """Return a reducer with a floor loaded, and the distances that it then holds."""
    reducer = _reducer()
    z_m = plane_z(CAMERA, view.T_terrain_sensor.rotation, FLOOR, -height_m)
    reducer.load(millimetres(z_m))
    k = reducer._baseline_px
    return reducer, reducer._z_m[k:-k, k:-k].astype(np.float64)


def test_sums_are_those_of_the_pixels() -> None:
    view = view_of(looking(20.0, 40.0), (3.0, 4.0, 5.0))
    reducer, z_m = _loaded(view)
    window = reducer.footprint(view)
    sums, added = reducer.reduce(view, window)
    pixels = _measure(reducer, z_m, view, window)
    seen = pixels.cell >= 0
    expected = np.zeros((window.cells_x * window.cells_y, 4))
    weight, height = pixels.weight[seen].astype(float), pixels.height_m[seen].astype(float)
    parts = np.stack([weight, weight * height, weight * height**2, np.ones(height.size)], axis=1)
    np.add.at(expected, pixels.cell[seen], parts)
    assert added == seen.sum() > 1000
    np.testing.assert_allclose(sums[: expected.shape[0]], expected, rtol=1e-12)


def test_the_same_frame_gives_the_same_bits_and_adds_up() -> None:
    view = view_of(looking(20.0, 40.0))
    reducer, _ = _loaded(view)
    window = reducer.footprint(view)
    first = reducer.reduce(view, window)[0].copy()
    twice = reducer.reduce(view, window)[0]
    np.testing.assert_allclose(twice, 2.0 * first, rtol=1e-13)
    other, _ = _loaded(view)
    assert other.reduce(view, window)[0].tobytes() == first.tobytes()


def test_only_what_is_inside_the_window_is_added() -> None:
    view = view_of(looking(0.0, 40.0))
    reducer, _ = _loaded(view)
    whole = reducer.footprint(view)
    all_sums, all_pixels = reducer.reduce(view, whole)
    grid = all_sums.reshape(whole.cells_y, whole.cells_x, 4).copy()
    part = CellWindow(whole.first_x + 20, whole.first_y + 30, 15, 12)
    other, _ = _loaded(view)
    sums, pixels = other.reduce(view, part)
    np.testing.assert_allclose(sums.reshape(12, 15, 4), grid[30:42, 20:35], rtol=1e-6)
    assert pixels == sums[:, 3].sum()
    assert 0 < pixels < all_pixels


def test_an_empty_window_takes_nothing() -> None:
    view = view_of(looking())
    reducer, _ = _loaded(view)
    _, pixels = reducer.reduce(view, CellWindow(5, 5, 0, 0))
    assert pixels == 0


def test_work_arrays_grow_to_the_largest_window_and_no_further() -> None:
    view = view_of(looking(0.0, 40.0))
    reducer, _ = _loaded(view)
    reducer.reduce(view, CellWindow(0, 0, 50, 40))[0][:] = 0.0
    reducer.reduce(view, CellWindow(0, 0, 10, 10))
    assert reducer._sums.shape == (2000, 4)


attitudes = st.one_of(
    st.tuples(*[st.floats(-180.0, 180.0)] * 3),
    st.tuples(*[st.sampled_from([-90.0, 0.0, 45.0, 90.0, 180.0])] * 3),
)


@settings(max_examples=300)
@given(
    attitudes,
    st.tuples(*[st.floats(-5.0, 5.0) | st.integers(-125, 125).map(lambda n: n * CELL_M)] * 3),
    st.sampled_from([3.3, 3.7, 4.0]),
    st.integers(0, 3),
)
def test_the_footprint_holds_every_reading(
    attitude: tuple[float, float, float],
    position_m: tuple[float, float, float],
    range_max_m: float,
    seed: int,
) -> None:
    """Also when the camera looks up or backwards, or along the borders of cells."""
    rotation = Rotation.from_euler("ZYX", attitude, degrees=True).as_matrix()
    view = view_of(rotation, position_m)
    reducer = _reducer(noise=NGUYEN_2012.with_range(0.4, range_max_m))
    farthest = round(1000 * range_max_m)
    depth = np.full((CAMERA.height_px, CAMERA.width_px), farthest, np.uint16)
    if seed:
        depth = np.random.default_rng(seed).integers(0, farthest + 1, depth.shape, np.uint16)
    readings = reducer.load(depth)
    _, inside = reducer.reduce(view, reducer.footprint(view))
    assert inside == readings > 0


def test_a_decimated_image_means_the_same_physics() -> None:
    """640 px and 320 px of one sensor: same variance per reading, same certainty per area."""
    full = CameraIntrinsics(640, 100, 580.0, 580.0, 319.5, 20.0)
    half = CameraIntrinsics(320, 50, 290.0, 290.0, 159.5, 9.75)  # pixel centres of pairs
    view = view_of(looking(0.0, 50.0), (0.0, 0.0, 1.0))
    variance = {}
    for camera in (full, half):
        reducer = FrameReducer(camera, KINECT_V1, MapSettings(resolution_m=CELL_M))
        z_m = plane_z(camera, view.T_terrain_sensor.rotation, FLOOR, -1.0)
        window = reducer.footprint(view)
        found = _measure(reducer, z_m, view, window)
        row = 10 if camera is half else 20
        variance[camera] = 1.0 / found.weight[row].astype(float)
        constants = reducer.frame_constants(view, window, (0, 0))
        pixels_per_area = (camera.fx_px / 580.0) ** 2
        assert constants.correlation_area_px == pytest.approx(42.0 * pixels_per_area)
    pairs = variance[full].reshape(-1, 2).mean(axis=1)
    np.testing.assert_allclose(variance[half], pairs, rtol=0.01)


def test_the_whole_of_a_coarse_image_is_at_least_one_reading() -> None:
    reducer = _reducer(noise=KINECT_V1)  # 64 px: a hundredth of the pixels, so 0.42 px
    view = view_of(looking())
    constants = reducer.frame_constants(view, reducer.footprint(view), (0, 0))
    assert constants.correlation_area_px == 1.0
