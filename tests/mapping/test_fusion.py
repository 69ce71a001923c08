"""The fused map against the closed form on planes, a slow integral, and what a step allows."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mapping.cells.elevation_map import CellState, ElevationMap
from mapping.errors import MappingError
from mapping.ground.fusion import fuse_map, narrow_table
from tests.mapping.maps import hilly_map, make_map

Float64Array = NDArray[np.float64]

CELL_M = 0.04


def _placed(map_: ElevationMap, covariance_m2: Float64Array) -> ElevationMap:
    """Return the map with this horizontal covariance (2, 2) in every known cell."""
    known = np.where(map_.known, 1.0, np.nan)
    return replace(
        map_,
        horizontal_xx_m2=(covariance_m2[0, 0] * known).astype(np.float32),
        horizontal_xy_m2=(covariance_m2[0, 1] * known).astype(np.float32),
        horizontal_yy_m2=(covariance_m2[1, 1] * known).astype(np.float32),
    )


def _ellipse(long_m: float, short_m: float, turned_rad: float) -> Float64Array:
    c, s = math.cos(turned_rad), math.sin(turned_rad)
    axes = np.array([[c, -s], [s, c]])
    covariance: Float64Array = axes @ np.diag([long_m**2, short_m**2]) @ axes.T
    return covariance


def _plane(slope: Float64Array, sigma_m: float = 0.004) -> ElevationMap:
    y, x = np.mgrid[-20:21, -20:21] * CELL_M
    return make_map(slope[0] * x + slope[1] * y, sigma_m)


@settings(max_examples=60)
@given(
    st.floats(-1.0, 1.0),
    st.floats(-1.0, 1.0),
    st.floats(0.02, 0.12),
    st.floats(0.02, 0.12),
    st.floats(-math.pi, math.pi),
)
def test_on_a_plane_the_variance_is_the_closed_form(
    slope_x: float, slope_y: float, long_m: float, short_m: float, turned_rad: float
) -> None:
    """V + g' Sigma_xy g; samples and the ellipse's end cost a few per cent."""
    slope = np.array([slope_x, slope_y])
    covariance = _ellipse(long_m, short_m, turned_rad)
    fused = fuse_map(_placed(_plane(slope), covariance))
    expected = 0.004**2 + slope @ covariance @ slope
    assert fused.variance_m2[20, 20] == pytest.approx(expected, rel=0.1)
    assert fused.elevation_m[20, 20] == pytest.approx(0.0, abs=1e-5)
    assert fused.lower_m[20, 20] <= -0.012
    assert fused.upper_m[20, 20] == pytest.approx(-fused.lower_m[20, 20], abs=1e-5)
    assert 2.0 <= fused.upper_m[20, 20] / math.sqrt(expected) <= 5.1


def test_a_wide_ellipse_leaves_no_cell_out() -> None:
    """10 x 7 cells of sigma: sampled at blocks, with the closed form, and every rock in bounds."""
    covariance, slope = _ellipse(0.4, 0.28, 0.7), np.array([0.2, -0.1])
    y, x = np.mgrid[-45:46, -45:46] * CELL_M
    plane = slope[0] * x + slope[1] * y
    window = (slice(45, 46), slice(45, 46))
    fused = fuse_map(_placed(make_map(plane, 0.004), covariance), window)
    expected = 0.004**2 + slope @ covariance @ slope
    assert fused.variance_m2[0, 0] == pytest.approx(expected, rel=0.05)
    assert fused.elevation_m[0, 0] == pytest.approx(0.0, abs=1e-5)
    for row, column in ((45, 52), (51, 49), (60, 55), (33, 38)):
        rock = plane.copy()
        rock[row, column] = 3.0
        fused = fuse_map(_placed(make_map(rock, 0.004), covariance), window)
        assert fused.upper_m[0, 0] == pytest.approx(3.012, abs=1e-5)


def test_the_ellipse_turns_the_way_its_covariance_says() -> None:
    """Long along x = y: what lies there counts, what lies across does not."""
    for turned, sign in ((0.25 * math.pi, 1), (-0.25 * math.pi, -1)):
        height = np.zeros((21, 21))
        height[12, 10 + 2 * sign] = height[8, 10 - 2 * sign] = 0.1
        height[12, 10 - 2 * sign] = height[8, 10 + 2 * sign] = -0.7
        fused = fuse_map(_placed(make_map(height, 0.001), _ellipse(0.1, 0.012, turned)))
        assert fused.elevation_m[10, 10] > 0.005
        assert fused.upper_m[10, 10] > 0.1
        assert fused.lower_m[10, 10] > -0.1


def _slow(map_: ElevationMap, row: int, column: int) -> tuple[float, float]:
    """Return mean and variance over the ellipse of a cell: every weight by its formula."""
    covariance = np.array(
        [
            [map_.horizontal_xx_m2[row, column], map_.horizontal_xy_m2[row, column]],
            [map_.horizontal_xy_m2[row, column], map_.horizontal_yy_m2[row, column]],
        ],
        float,
    )
    values, axes = np.linalg.eigh(covariance / CELL_M**2)
    table = narrow_table()
    wide = np.where(
        values < 1.0, np.interp(values, np.linspace(0.0, 1.0, table.size), table), values
    )
    inverse = axes @ np.diag(1.0 / wide) @ axes.T
    rows, columns = np.indices(map_.state.shape)
    offset = np.stack([columns - column, rows - row], axis=-1).astype(float)
    square = np.einsum("...i,ij,...j", offset, inverse, offset)
    confirmed = (map_.state == CellState.MEASURED) | (map_.state == CellState.UNCERTAIN)
    use = confirmed & (square <= 3.5**2)
    weight = np.exp(-0.5 * square[use])
    weight /= weight.sum()
    height, variance = map_.elevation_m[use].astype(float), map_.variance_m2[use].astype(float)
    mean = float(weight @ height)
    return mean, float(weight @ (height**2 + variance)) - mean**2


def test_every_cell_of_a_hilly_map_is_the_integral_over_its_ellipse() -> None:
    map_ = hilly_map()
    random = np.random.default_rng(3)
    sides = random.uniform(0.0, 0.05, (3, *map_.state.shape))
    map_ = replace(
        map_,
        horizontal_xx_m2=(0.02**2 + sides[0] ** 2).astype(np.float32),
        horizontal_xy_m2=(0.9 * sides[0] * sides[1] * np.sign(sides[2] - 0.025)).astype(np.float32),
        horizontal_yy_m2=(0.02**2 + sides[1] ** 2).astype(np.float32),
    )
    fused = fuse_map(map_)
    confirmed = (map_.state == CellState.MEASURED) | (map_.state == CellState.UNCERTAIN)
    np.testing.assert_array_equal(np.isfinite(fused.elevation_m), confirmed)
    for row, column in np.argwhere(confirmed)[::7]:
        mean, variance = _slow(map_, row, column)
        assert fused.elevation_m[row, column] == pytest.approx(mean, abs=1e-6)
        assert fused.variance_m2[row, column] == pytest.approx(variance, rel=1e-4, abs=1e-9)
        assert fused.lower_m[row, column] < map_.elevation_m[row, column]
        assert fused.upper_m[row, column] > map_.elevation_m[row, column]


def test_a_window_has_the_bits_of_the_whole() -> None:
    map_ = _placed(hilly_map(), _ellipse(0.08, 0.03, 0.6))
    whole = fuse_map(map_)
    window = (slice(3, 17), slice(20, 40))
    part = fuse_map(map_, window)
    for name in ("elevation_m", "variance_m2", "lower_m", "upper_m"):
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[window])
    assert fuse_map(map_, (slice(5, 5), slice(None))).elevation_m.shape == (0, 40)
    with pytest.raises(MappingError, match="has a step; expected slices"):
        fuse_map(map_, (slice(0, 9, 2), slice(None)))


def test_beside_a_step_the_bounds_are_its_bottom_and_top() -> None:
    height = np.where(np.arange(20) < 10, 0.0, 0.2) * np.ones((20, 1))
    fused = fuse_map(make_map(height, 0.001))
    assert fused.lower_m[10, 9] == pytest.approx(-0.003, abs=1e-6)
    assert fused.upper_m[10, 9] == pytest.approx(0.203, abs=1e-6)
    assert fused.upper_m[10, 5] == pytest.approx(0.003, abs=1e-6)
    assert 0.0 < fused.elevation_m[10, 9] < 0.1
    assert fused.variance_m2[10, 9] > 1e-3


def test_the_part_that_the_place_has_in_the_variance_is_not_counted_twice() -> None:
    flat = make_map(np.zeros((9, 9)), 0.005)
    part = np.full((9, 9), 9e-6, np.float32)
    fused = fuse_map(replace(flat, horizontal_m2=part, variance_m2=flat.variance_m2 + part))
    np.testing.assert_allclose(fused.variance_m2, 0.005**2, rtol=1e-5)


@pytest.mark.parametrize("wrong", [math.nan, math.inf])
def test_what_is_not_finite_does_not_spread(wrong: float) -> None:
    height = np.zeros((15, 15))
    height[7, 7] = wrong
    state = np.full((15, 15), CellState.MEASURED)
    fused = fuse_map(make_map(height, 0.01, state))
    assert np.isnan(fused.elevation_m[7, 7])
    assert np.count_nonzero(np.isnan(fused.elevation_m)) == 1
    np.testing.assert_allclose(fused.upper_m[6, 6], 0.03, rtol=1e-5)


@pytest.mark.parametrize("axes_m", [(1e3, 1e3), (1e3, 450.0), (1e15, 1.0)])
def test_a_place_that_nobody_knows_is_bounded_and_does_not_take_for_ever(
    axes_m: tuple[float, float],
) -> None:
    map_ = _placed(hilly_map(), _ellipse(*axes_m, 0.0))
    fused = fuse_map(map_)
    assert np.isfinite(fused.elevation_m[map_.state == CellState.MEASURED]).all()


def test_what_is_no_covariance_is_taken_without_its_negative_part() -> None:
    """As the paper's printed equations may make it."""
    map_ = hilly_map()
    odd = fuse_map(_placed(map_, np.array([[4e-4, 9e-4], [9e-4, 4e-4]])))
    values, axes = np.linalg.eigh(np.array([[4e-4, 9e-4], [9e-4, 4e-4]]))
    narrowest = 0.02 * CELL_M**2
    sound = axes @ np.diag(np.maximum(values, narrowest)) @ axes.T
    expected = fuse_map(_placed(map_, sound))
    np.testing.assert_allclose(odd.variance_m2, expected.variance_m2, rtol=1e-3)
