"""What is read out of a grid: parts of the variance, states, slopes, rectangle, fingerprint."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from mapping.cells.elevation_map import CellState, ElevationMap, read_out
from mapping.cells.grid import CellWindow, Grid, GrowingGrid, ScrollingGrid
from mapping.cells.relief_kernels import surrounding_relief
from mapping.errors import MappingError
from mapping.settings import MapSettings
from tests.mapping.maps import hilly_map

Float64Array = NDArray[np.float64]

SETTINGS = MapSettings(resolution_m=0.1, window_m=2.0, sigma_floor_m=1e-6)


def _filled(
    height_m: Float64Array,
    variance_m2: float = 1e-6,
    frames: int = 5,
    first: tuple[int, int] = (-3, -7),
    grid: Grid | None = None,
) -> Grid:
    """Return a grid that saw these heights (rows = y) from cell `first` on; NaN = unseen."""
    grid = grid or GrowingGrid(SETTINGS)
    rows, columns = height_m.shape
    window = CellWindow(*first, columns, rows)
    middle = (np.array(first) + np.array([columns, rows]) / 2.0) * SETTINGS.resolution_m
    grid.prepare(window, float(middle[0]), float(middle[1]))
    row, column = grid.position(window)
    places = np.ix_(
        (row + np.arange(rows)) % grid.layers.frames.shape[0],
        (column + np.arange(columns)) % grid.layers.frames.shape[1],
    )
    seen = np.isfinite(height_m)
    grid.layers.elevation_m[places] = np.where(seen, height_m, 0.0)
    grid.layers.variance_m2[places] = np.where(seen, variance_m2, 0.0)
    grid.layers.frames[places] = np.where(seen, frames, 0)
    grid.layers.pixels[places] = np.where(seen, 10 * frames, 0)
    grid.layers.last_ns[places] = np.where(seen, 77, 0)
    return grid


def _plane(slope_x: float, slope_y: float, rows: int = 5, columns: int = 6) -> Float64Array:
    y, x = np.mgrid[0:rows, 0:columns] * SETTINGS.resolution_m
    height: Float64Array = slope_x * x + slope_y * y
    return height


def test_the_map_is_cut_to_the_cells_that_were_seen() -> None:
    height = np.full((9, 8), np.nan)
    height[2:5, 3:7] = 1.0
    height[3, 4] = np.nan
    found = read_out(_filled(height, first=(-5, 4)), SETTINGS, {})
    np.testing.assert_allclose(found.x_m, [-0.15, -0.05, 0.05, 0.15])
    np.testing.assert_allclose(found.y_m, [0.65, 0.75, 0.85])
    assert found.elevation_m.shape == (3, 4)
    assert np.isnan(found.elevation_m[1, 1])
    assert np.count_nonzero(np.isnan(found.elevation_m)) == 1
    assert found.known.sum() == 11


def test_a_window_that_wraps_around_reads_out_like_a_map_that_does_not() -> None:
    height = _plane(0.3, -0.2, 7, 9)
    height[2, 3] = np.nan
    for first in ((-3, -7), (13, 25), (-1000, 999)):
        wrapped = read_out(_filled(height, first=first, grid=ScrollingGrid(SETTINGS)), SETTINGS, {})
        assert wrapped.sha256() == read_out(_filled(height, first=first), SETTINGS, {}).sha256()


def test_unknown_cells_say_nothing() -> None:
    height = np.array([[0.1, np.nan, 0.3]])
    found = read_out(_filled(height), SETTINGS, {})
    for name in ("elevation_m", "variance_m2", "independent_m2", "systematic_m2", "relief_m2"):
        layer = getattr(found, name)
        assert layer.dtype == np.float32, name
        np.testing.assert_array_equal(np.isnan(layer), [[False, True, False]], err_msg=name)
    assert found.state[0, 1] == CellState.UNKNOWN
    assert (found.frames[0, 1], found.pixels[0, 1], found.last_seen_ns[0, 1]) == (0, 0, 0)
    assert found.last_seen_ns[0, 0] == 77


def test_the_variance_is_the_sum_of_its_parts() -> None:
    grid = _filled(_plane(0.5, 0.0), variance_m2=4e-6)
    grid.layers.systematic_a_m[:] = 0.003
    grid.layers.systematic_b_m[:] = -0.004
    grid.layers.systematic_c_m[:] = 0.012
    grid.layers.systematic_bias_m[:] = 0.084
    grid.layers.relief_m2[:] = 5e-5
    settings = replace(SETTINGS, mount_sigma_m=0.005, relief_share=0.06)
    found = read_out(grid, settings, {})
    np.testing.assert_allclose(found.independent_m2, 4e-6, rtol=1e-6)
    # 3-4-5, 5-12-13, 13-84-85 mm; and 5 mm of the mount's position.
    np.testing.assert_allclose(found.systematic_m2, 0.085**2 + 0.005**2, rtol=1e-6)
    # A quarter is the square of the slope, and 0.06 + 3/4 of it the share that one side may lack.
    inclined = (0.06 + 0.75) * 0.25 * 0.1**2 / 12.0
    np.testing.assert_allclose(found.relief_m2, 0.06 * 5e-5 + inclined, rtol=1e-4)
    total = found.independent_m2 + found.systematic_m2 + found.relief_m2
    np.testing.assert_array_equal(found.variance_m2, total)
    np.testing.assert_allclose(found.sigma_m, np.sqrt(total))
    np.testing.assert_allclose(found.upper_m - found.elevation_m, 3.0 * found.sigma_m, atol=1e-6)
    np.testing.assert_allclose(found.elevation_m - found.lower_m, 3.0 * found.sigma_m, atol=1e-6)


def test_a_cell_of_few_readings_has_its_height_from_around_it() -> None:
    random = np.random.default_rng(1)
    grid = _filled(random.normal(0.0, 0.001, (7, 7)), variance_m2=1e-12, frames=1000)
    settings = replace(SETTINGS, relief_share=0.0, relief_frames=0.0)

    def relief(readings: int) -> Float64Array:
        grid.layers.pixels[:] = 1000 * readings
        return read_out(grid, settings, {}).relief_m2.astype(np.float64)

    rest = relief(10**6)  # what is left without the sparse cell's part
    np.testing.assert_allclose(relief(10) - rest, (relief(2) - rest) / 25.0, rtol=1e-3)
    # 1 / n^2 times the variance around a plane, which is here that of the heights.
    assert np.median(relief(1) - rest) == pytest.approx(1e-6, rel=0.4)
    assert np.median(relief(2) - rest) == pytest.approx(0.25e-6, rel=0.4)


@pytest.mark.parametrize(
    ("left", "right", "above", "below", "share"),
    [
        (10_000, 40_000, 10_000, 10_000, 0.28125),  # (3 / 2)^2 / 4 = g^2, and half of that
        (40_000, 10_000, 10_000, 10_000, 0.28125),
        (10_000, 10_000, 40_000, 10_000, 0.28125),
        (40_000, 10_000, 10_000, 40_000, 0.5625),
        (40_000, 40_000, 90_000, 90_000, 0.0),  # alike on both sides
        (4, 10**9, 10_000, 10_000, 2.0),  # a neighbour's height, and no worse
    ],
)
def test_a_cell_of_uneven_readings_has_its_height_from_the_denser_side(
    left: int, right: int, above: int, below: int, share: float
) -> None:
    height = np.random.default_rng(1).normal(0.0, 0.001, (7, 7))
    grid = _filled(height, variance_m2=1e-12, frames=4, first=(0, 0))
    settings = replace(SETTINGS, relief_share=0.0, relief_frames=0.0)
    grid.layers.pixels[grid.layers.frames > 0] = 10_000
    even = read_out(grid, settings, {}).relief_m2[3, 3]
    row, column = grid.position(CellWindow(3, 3, 1, 1))
    for (down, across), pixels in zip(
        ((0, -1), (0, 1), (-1, 0), (1, 0)), (left, right, above, below), strict=True
    ):
        grid.layers.pixels[row + down, column + across] = pixels
    around = np.empty(height.shape, np.float32)
    everywhere = np.ones(height.shape, np.bool_)
    surrounding_relief(height, np.full(height.shape, 1e-12, np.float32), everywhere, around)
    found = read_out(grid, settings, {}).relief_m2[3, 3] - even
    assert found == pytest.approx(share * around[3, 3], rel=1e-3, abs=1e-12)


def test_the_bounds_of_a_cell_hold_what_stands_up_in_it() -> None:
    """A post of 0.3 m in a cell: half of its readings on the floor, half up along it."""
    grid = _filled(np.zeros((5, 5)))
    mean, spread = 0.075, 0.3**2 / 6.0 - 0.075**2
    place = grid.position(CellWindow(-1, -5, 1, 1))
    grid.layers.elevation_m[place], grid.layers.relief_m2[place] = mean, spread
    found = read_out(grid, replace(SETTINGS, uncertain_sigma_m=0.05), {})
    assert found.elevation_m[2, 2] == np.float32(mean)
    assert found.upper_m[2, 2] > 0.3
    assert found.state[2, 2] == CellState.UNCERTAIN
    grid.layers.relief_m2[place] = 0.05**2  # a slope of 60 degrees in a cell of 0.1 m
    grid.layers.elevation_m[place] = 0.0
    assert read_out(grid, SETTINGS, {}).sigma_m[2, 2] < 0.01


def test_less_than_no_relief_counts_as_none() -> None:
    grid = _filled(_plane(0.0, 0.0))
    grid.layers.relief_m2[:] = -1e-3
    assert not read_out(grid, SETTINGS, {}).relief_m2.any()


def _slope2(found: ElevationMap) -> Float64Array:
    """Return s = |grad h|^2 that the relief part holds, where the cells have no relief themselves.

    Relief is (relief_share + min(1, 3 s)) s d^2 / 12.
    """
    share = SETTINGS.relief_share
    part = found.relief_m2.astype(np.float64) * 12.0 / SETTINGS.resolution_m**2
    gentle = (np.sqrt(share**2 + 12.0 * part) - share) / 6.0
    return np.where(3.0 * gentle < 1.0, gentle, part / (share + 1.0))


def test_slopes_are_exact_on_a_plane_also_at_its_rim_and_beside_gaps() -> None:
    height = _plane(0.4, -0.3, 7, 8)
    height[3, 4] = np.nan
    slope2 = _slope2(read_out(_filled(height), SETTINGS, {}))
    seen = np.isfinite(height)
    np.testing.assert_allclose(slope2[seen], 0.25, rtol=1e-4)


def test_between_two_gaps_a_slope_is_taken_as_none() -> None:
    height = np.full((3, 5), np.nan)
    height[1] = [0.0, np.nan, 0.7, np.nan, 0.2]
    height[0, 2] = 0.9
    slope2 = _slope2(read_out(_filled(height), SETTINGS, {}))
    assert slope2[1, 0] == slope2[1, 4] == 0.0
    assert slope2[1, 2] == pytest.approx(4.0, rel=1e-4)  # 0.2 m over 0.1 m, along y alone


def test_a_curve_has_the_slope_of_its_chord() -> None:
    height = np.array([[0.0, 0.1, 0.4, 0.9]])
    slope2 = _slope2(read_out(_filled(height), SETTINGS, {}))
    np.testing.assert_allclose(slope2[0], [1.0, 4.0, 16.0, 25.0], rtol=1e-4)


def test_flying_pixels_have_no_say_in_the_slope_of_their_neighbours() -> None:
    height = _plane(0.4, -0.3)
    height[2, 3] = 9.0
    grid = _filled(height)
    row, column = grid.position(CellWindow(0, -5, 1, 1))  # that cell
    grid.layers.frames[row, column] = 1
    found = read_out(grid, SETTINGS, {})
    assert found.state[2, 3] == CellState.UNCONFIRMED
    others = found.state == CellState.MEASURED
    np.testing.assert_allclose(_slope2(found)[others], 0.25, rtol=1e-3)


@pytest.mark.parametrize(
    ("frames", "pixels", "sigma_m", "state"),
    [
        (1, 100, 0.001, CellState.UNCONFIRMED),
        (9, 3, 0.001, CellState.UNCONFIRMED),
        (1, 1, 0.500, CellState.UNCONFIRMED),
        (2, 4, 0.001, CellState.MEASURED),
        (2, 4, 0.01499, CellState.MEASURED),
        (2, 4, 0.01501, CellState.UNCERTAIN),
        (2**32 - 1, 2**32 - 1, 0.9, CellState.UNCERTAIN),
    ],
)
def test_the_state_says_how_far_a_cell_can_be_trusted(
    frames: int, pixels: int, sigma_m: float, state: CellState
) -> None:
    grid = _filled(np.zeros((3, 3)), variance_m2=sigma_m**2)
    grid.layers.frames[grid.layers.frames > 0] = frames
    grid.layers.pixels[grid.layers.frames > 0] = pixels
    found = read_out(grid, SETTINGS, {})
    assert (found.state == state).all()
    assert found.state.dtype == np.uint8


def test_what_makes_a_cell_uncertain_is_its_whole_variance() -> None:
    settings = replace(SETTINGS, mount_sigma_m=0.02)
    assert (read_out(_filled(np.zeros((2, 2))), settings, {}).state == CellState.UNCERTAIN).all()


def test_high_above_the_origin_the_rounding_counts() -> None:
    high = read_out(_filled(np.full((2, 2), 10_000.0), variance_m2=1e-8), SETTINGS, {})
    # float32 has steps of 2^-10 m from 8192 m on.
    np.testing.assert_allclose(high.independent_m2, 1e-8 + 2.0**-20 / 12.0, rtol=1e-6)
    low = read_out(_filled(np.full((2, 2), -1.0), variance_m2=1e-8), SETTINGS, {})
    np.testing.assert_allclose(low.independent_m2, 1e-8, rtol=1e-6)
    deep = read_out(_filled(np.full((2, 2), -10_000.0), variance_m2=1e-8), SETTINGS, {})
    np.testing.assert_array_equal(deep.independent_m2, high.independent_m2)


def test_slopes_high_above_the_origin_are_not_rounded() -> None:
    height = 10_000.0 + _plane(0.01, 0.0)
    slope2 = _slope2(read_out(_filled(height), SETTINGS, {}))
    np.testing.assert_allclose(slope2, 1e-4, rtol=1e-3)


@pytest.mark.parametrize("grid", [GrowingGrid(SETTINGS), ScrollingGrid(SETTINGS)])
def test_a_grid_that_saw_nothing_makes_no_map(grid: Grid) -> None:
    with pytest.raises(MappingError, match="no depth reading reached the map; check the range"):
        read_out(grid, SETTINGS, {})
    grid.prepare(CellWindow(0, 0, 5, 5), 0.0, 0.0)
    with pytest.raises(MappingError, match="no depth reading reached the map"):
        read_out(grid, SETTINGS, {})


def test_reading_out_changes_nothing() -> None:
    grid = _filled(_plane(0.1, 0.2))
    grid.layers.relief_m2[:] = -1e-5
    first = read_out(grid, SETTINGS, {})
    first.frames[:] = 0
    first.elevation_m[:] = 0.0
    again = read_out(grid, SETTINGS, {})
    assert again.frames.all()
    assert again.elevation_m.any()


ARRAYS = [
    item.name
    for item in fields(ElevationMap)
    if isinstance(getattr(hilly_map(3, 4), item.name), np.ndarray)
]


@pytest.mark.parametrize("name", ARRAYS)
def test_the_fingerprint_changes_with_any_bit(name: str) -> None:
    map_ = hilly_map(5, 6)
    before = map_.sha256()
    flipped = getattr(map_, name).copy()
    flipped.reshape(-1).view(np.uint8)[-1] ^= 1
    assert replace(map_, **{name: flipped}).sha256() != before
    assert map_.sha256() == before


def test_the_fingerprint_knows_shape_and_type_but_not_how_the_map_was_made() -> None:
    map_ = hilly_map(4, 4)
    assert replace(map_, frames=map_.frames.reshape(2, 8)).sha256() != map_.sha256()
    assert replace(map_, pixels=map_.pixels.view(np.int32)).sha256() != map_.sha256()
    assert replace(map_, attributes={"other": 1}).sha256() == map_.sha256()
    assert replace(map_, elevation_m=np.asfortranarray(map_.elevation_m)).sha256() == map_.sha256()


def test_there_are_as_many_arrays_as_the_map_has_layers() -> None:
    assert len(ARRAYS) == 16
