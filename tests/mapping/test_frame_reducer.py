"""A frame reduced to sums per cell: what is loaded, which cells are reached, what is added."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mapping.cells.grid import CellWindow
from mapping.errors import MappingError
from mapping.measurement import FrameReducer, View
from mapping.noise import KINECT_V1, NGUYEN_2012, DepthNoiseModel
from mapping.settings import MapSettings
from tests.mapping.scenes import CAMERA, looking, millimetres, plane_z, view_of

CELL_M = 0.04


def _reducer(noise: DepthNoiseModel = NGUYEN_2012) -> FrameReducer:
    return FrameReducer(CAMERA, noise, MapSettings(resolution_m=CELL_M))


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


def _loaded(view: View) -> FrameReducer:
    """Return a reducer with a floor loaded, 0.8 m below the camera."""
    reducer = _reducer()
    z_m = plane_z(CAMERA, view.T_terrain_sensor.rotation, (0.0, 0.0, 1.0), -0.8)
    reducer.load(millimetres(z_m))
    return reducer


def test_the_same_frame_gives_the_same_bits_and_adds_up() -> None:
    view = view_of(looking(20.0, 40.0))
    reducer = _loaded(view)
    window = reducer.footprint(view)
    first = reducer.reduce(view, window)[0].copy()
    twice = reducer.reduce(view, window)[0]
    np.testing.assert_allclose(twice, 2.0 * first, rtol=1e-13)
    other = _loaded(view)
    assert other.reduce(view, window)[0].tobytes() == first.tobytes()


def test_only_what_is_inside_the_window_is_added() -> None:
    view = view_of(looking(0.0, 40.0))
    reducer = _loaded(view)
    whole = reducer.footprint(view)
    all_sums, all_pixels = reducer.reduce(view, whole)
    grid = all_sums.reshape(whole.cells_y, whole.cells_x, 4).copy()
    part = CellWindow(whole.first_x + 20, whole.first_y + 30, 15, 12)
    other = _loaded(view)
    sums, pixels = other.reduce(view, part)
    np.testing.assert_allclose(sums.reshape(12, 15, 4), grid[30:42, 20:35], rtol=1e-6)
    assert pixels == sums[:, 3].sum()
    assert 0 < pixels < all_pixels


def test_an_empty_window_takes_nothing() -> None:
    view = view_of(looking())
    reducer = _loaded(view)
    _, pixels = reducer.reduce(view, CellWindow(5, 5, 0, 0))
    assert pixels == 0


def test_work_arrays_grow_to_the_largest_window_and_no_further() -> None:
    view = view_of(looking(0.0, 40.0))
    reducer = _loaded(view)
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


def test_the_whole_of_a_coarse_image_is_at_least_one_reading() -> None:
    reducer = _reducer(noise=KINECT_V1)  # 64 px: a hundredth of the pixels, so 0.42 px
    view = view_of(looking())
    constants = reducer.frame_constants(view, reducer.footprint(view), (0, 0))
    assert constants.correlation_area_px == 1.0
