"""The pixel kernels against a slow oracle: heights, weights, cells and sums."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.samples import CameraIntrinsics
from mapping import measurement_kernels as kernels
from mapping.cells.grid import CellWindow
from mapping.measurement import SENSOR_WIDTH_PX, FrameReducer, View, _view_constants
from mapping.noise import KINECT_QUANTISATION, KINECT_V1, NGUYEN_2012, DepthNoiseModel
from mapping.settings import MapSettings
from tests.mapping import oracle
from tests.mapping.scenes import CAMERA, looking, millimetres, plane_z, rays, view_of

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


def test_the_variance_is_what_a_moved_point_does_to_its_height() -> None:
    """Finite differences of the height: along the ray with z, and across it to both sides."""
    view = view_of(looking(25.0, 50.0, -15.0), (1.0, 2.0, 0.5))
    z_m = np.zeros((CAMERA.height_px, CAMERA.width_px))
    z_m[::4, ::4] = 1.3
    reducer = _reducer()
    found = _measure(reducer, z_m, view, reducer.footprint(view))
    focal_px = CAMERA.fx_px * SENSOR_WIDTH_PX / CAMERA.width_px
    ray_of = rays(CAMERA)
    facing = np.arccos(1.0 / np.linalg.norm(ray_of, axis=-1))
    z = np.full(z_m.shape, 1.3)
    axial = NGUYEN_2012.axial_sigma_m(z, facing)
    lateral = NGUYEN_2012.lateral_sigma_m(z, facing, focal_px)
    step = 1e-4
    for v, u in np.argwhere(z_m > 0.0):
        ray = ray_of[v, u]
        _, _, basis = np.linalg.svd(ray[np.newaxis])
        moves = (axial[v, u] * ray, lateral[v, u] * basis[1], lateral[v, u] * basis[2])
        variance = 0.0
        for move in moves:
            up, down = (
                view.T_terrain_sensor.apply(1.3 * ray + sign * step * move)[2] for sign in (1, -1)
            )
            variance += ((up - down) / (2.0 * step)) ** 2
        assert 1.0 / found.weight[v, u] == pytest.approx(variance, rel=1e-4)


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


def test_sums_are_those_of_the_pixels() -> None:
    view = view_of(looking(20.0, 40.0), (3.0, 4.0, 5.0))
    reducer = _reducer()
    reducer.load(millimetres(plane_z(CAMERA, view.T_terrain_sensor.rotation, FLOOR, -0.8)))
    k = reducer._baseline_px
    z_m = reducer._z_m[k:-k, k:-k].astype(np.float64)
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
