"""Layers: right on surfaces that have a known answer, blind to cells that do not count."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mapping.cells.elevation_map import CellState, ElevationMap
from mapping.errors import MappingError
from mapping.ground.layers import Combination, DerivedLayers, LayerSettings, derive, disc, score
from tests.mapping.layer_definitions import by_definition
from tests.mapping.maps import hilly_map, make_map

NAN = np.nan
EDGE_M = 0.04
# Parameters of the traversability package whose result is kept with the real data; its windows
# have no least support, four of nine cells is what a corner of the map has.
PACKAGE = LayerSettings(
    plane_radius_m=0.05,
    step_radius_m=0.04,
    support_share=0.4,
    critical_slope_rad=1.0,
    critical_roughness_m=0.05,
    critical_step_m=0.12,
    step_cells=4,
    combination="mean",
)


def _arrays(layers: DerivedLayers) -> dict[str, NDArray[np.float32]]:
    return {item.name: getattr(layers, item.name) for item in fields(layers)}


def _plane(gradient_x: float, gradient_y: float, size: int = 12) -> NDArray[np.float64]:
    y, x = np.mgrid[0:size, 0:size] * EDGE_M
    plane: NDArray[np.float64] = gradient_x * x + gradient_y * y
    return plane


@settings(max_examples=40, deadline=None)
@given(
    steepness=st.floats(0.0, 3.0),
    yaw=st.floats(0.0, 2.0 * np.pi),
    height_m=st.floats(-50.0, 50.0),
    seed=st.integers(0, 999),
)
def test_a_plane_has_its_slope_whatever_way_it_faces(
    steepness: float, yaw: float, height_m: float, seed: int
) -> None:
    heights = height_m + _plane(steepness * np.cos(yaw), steepness * np.sin(yaw))
    heights[np.random.default_rng(seed).random(heights.shape) < 0.2] = NAN
    layers = derive(make_map(heights), LayerSettings(support_share=0.3))
    slope = layers.slope_rad[np.isfinite(layers.slope_rad)]
    assert slope.size > 80
    rounding = 2e-6 * max(abs(height_m), 1.0) / EDGE_M  # of the heights, which are float32
    np.testing.assert_allclose(slope, np.arctan(steepness), atol=rounding)
    np.testing.assert_allclose(np.nan_to_num(layers.roughness_m), 0.0, atol=rounding)
    down = -np.sin(np.arctan(steepness)) * np.array([np.cos(yaw), np.sin(yaw)])
    for normal, true in zip((layers.normal_x, layers.normal_y), down, strict=True):
        np.testing.assert_allclose(normal[np.isfinite(normal)], true, atol=rounding)


def _rough_map(seed: int, shape: tuple[int, int] = (15, 18)) -> ElevationMap:
    random = np.random.default_rng(seed)
    heights = 0.1 * random.standard_normal(shape).cumsum(axis=0)
    heights[random.random(shape) < 0.3] = NAN
    return make_map(heights, 0.002 + 0.01 * random.random(shape))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 999), combination=st.sampled_from(["worst", "mean"]))
def test_layers_agree_with_their_definitions_in_plain_numpy(
    seed: int, combination: Combination
) -> None:
    map_ = _rough_map(seed)
    chosen = LayerSettings(support_share=0.4, combination=combination)
    layers = derive(map_, chosen)
    expected = by_definition(map_, chosen)
    for name, layer in expected.items():
        np.testing.assert_allclose(_arrays(layers)[name], layer, rtol=1e-3, atol=2e-6, err_msg=name)
    length2 = sum(np.square(getattr(layers, f"normal_{axis}")) for axis in "xyz")
    np.testing.assert_allclose(length2[np.isfinite(length2)], 1.0, rtol=1e-5)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 999), turns=st.integers(0, 3), mirrored=st.booleans())
def test_layers_turn_with_the_map(seed: int, turns: int, mirrored: bool) -> None:
    map_ = _rough_map(seed, (12, 12))

    def moved(layer: NDArray[Any]) -> NDArray[Any]:
        turned = np.rot90(layer, turns)
        return np.ascontiguousarray(turned[:, ::-1] if mirrored else turned)

    changes: dict[str, Any] = {
        item.name: moved(value)
        for item in fields(map_)
        if isinstance(value := getattr(map_, item.name), np.ndarray) and value.ndim == 2
    }
    there = derive(replace(map_, **changes))
    for name, layer in _arrays(derive(map_)).items():
        if name not in ("normal_x", "normal_y"):
            np.testing.assert_allclose(_arrays(there)[name], moved(layer), rtol=1e-4, atol=1e-6)


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 999),
    nonsense=st.sampled_from([NAN, np.inf, -np.inf, 1e30, -5.0]),
    variance=st.sampled_from([NAN, np.inf, 0.0, 1e30]),
)
def test_cells_that_do_not_count_change_nothing(
    seed: int, nonsense: float, variance: float
) -> None:
    map_ = hilly_map(seed=seed)
    idle = map_.state <= CellState.UNCONFIRMED
    spoilt = replace(
        map_,
        elevation_m=np.where(idle, np.float32(nonsense), map_.elevation_m),
        independent_m2=np.where(idle, np.float32(variance), map_.independent_m2),
        relief_m2=np.where(idle, np.float32(variance), map_.relief_m2),
    )
    spoilt_layers = _arrays(derive(spoilt))
    for name, layer in _arrays(derive(map_)).items():
        assert layer.dtype == np.float32
        np.testing.assert_array_equal(spoilt_layers[name], layer)
        assert np.isnan(layer[idle]).all()
        assert np.isfinite(layer[~idle]).mean() > 0.9


def test_a_confirmed_cell_without_a_finite_height_counts_as_none() -> None:
    heights = _plane(0.3, 0.0)
    heights[5, 5] = np.inf
    layers = derive(make_map(heights, state=np.full(heights.shape, CellState.MEASURED)))
    assert np.isnan(layers.slope_rad[5, 5])
    assert np.isfinite(np.delete(layers.slope_rad, 5, axis=0)).all()


def test_the_place_in_the_map_and_the_datum_do_not_matter() -> None:
    map_ = hilly_map()
    alone = _arrays(derive(map_))
    wide = np.full((40, 60), NAN)
    wide[7:37, 11:51] = map_.elevation_m + 1.0
    state, sigma = np.zeros((40, 60)), np.zeros((40, 60))
    state[7:37, 11:51], sigma[7:37, 11:51] = map_.state, np.nan_to_num(map_.sigma_m)
    for name, layer in _arrays(derive(make_map(wide, sigma, state))).items():
        np.testing.assert_allclose(layer[7:37, 11:51], alone[name], rtol=1e-4, atol=2e-5)


def test_the_same_map_gives_the_same_bits() -> None:
    first, second = (_arrays(derive(hilly_map())) for _ in range(2))
    assert all(first[name].tobytes() == second[name].tobytes() for name in first)


def test_a_wall_is_a_step_beside_it_and_nowhere_else() -> None:
    heights = np.zeros((12, 12))
    heights[:, 6:] = 0.3
    layers = derive(make_map(heights))
    np.testing.assert_allclose(layers.step_m[:, 5:7], 0.3, rtol=1e-6)
    np.testing.assert_array_equal(layers.step_m[:, :5], 0.0)
    np.testing.assert_array_equal(layers.step_m[:, 7:], 0.0)
    np.testing.assert_array_equal(layers.traversability[:, 4:8], 0.0)
    np.testing.assert_array_equal(layers.traversability[:, :3], 1.0)


def test_traversability_judges_steps_that_their_neighbours_support() -> None:
    heights = np.zeros((11, 11))
    heights[5, 5] = 0.13
    lone = derive(make_map(heights), LayerSettings(step_radius_m=0.04, step_cells=8))
    assert lone.step_m[5, 5] == pytest.approx(0.13)
    # The cell and its four neighbours see a step of 13 cm; eight would make it count in full.
    assert lone.supported_step_m[5, 5] == pytest.approx(5 / 8 * 0.13)
    low = derive(make_map(np.where(heights > 0.0, 0.11, 0.0)))
    assert low.supported_step_m.max() == 0.0


def test_a_single_score_of_zero_rules_unless_the_mean_is_asked_for() -> None:
    heights = np.zeros((12, 12))
    heights[:, 6:] = 0.13
    map_ = make_map(heights)
    worst, mean = derive(map_), derive(map_, LayerSettings(combination="mean"))
    assert worst.traversability[6, 6] == 0.0
    assert mean.traversability[6, 6] > 0.0
    assert (mean.traversability >= worst.traversability).all()


def test_a_pole_is_vertical_and_has_no_direction() -> None:
    heights = np.zeros((5, 5))
    heights[2, 2] = 1.0
    layers = derive(make_map(heights), LayerSettings(plane_radius_m=0.06))
    assert layers.slope_rad[2, 2] == pytest.approx(np.pi / 2)
    assert layers.normal_z[2, 2] == 0.0
    assert np.isnan(layers.normal_x[2, 2])
    assert layers.traversability[2, 2] == 0.0


@pytest.mark.parametrize(
    "heights",
    [
        [[0.0]],
        [[NAN, NAN], [NAN, 0.0]],
        [[0.0, 0.1, 0.2, 0.3, 0.4]],  # a line of cells: no plane
    ],
)
def test_too_little_support_gives_no_plane(heights: list[list[float]]) -> None:
    layers = derive(make_map(heights), LayerSettings(support_share=0.01))
    assert np.isnan(layers.slope_rad).all()
    assert np.isnan(layers.traversability).all()


def test_a_map_without_confirmed_cells_has_no_layers() -> None:
    layers = derive(make_map([[1.0, 2.0]], state=CellState.UNCONFIRMED))
    assert all(np.isnan(layer).all() for layer in _arrays(layers).values())


def test_the_noise_layers_say_what_noise_does() -> None:
    sigma_m, random = 0.005, np.random.default_rng(3)
    size = 400
    _, x = np.mgrid[0:size, 0:size] * EDGE_M
    noise = sigma_m * random.standard_normal((size, size))
    map_ = make_map(0.5 * x + noise)
    variance = np.full_like(map_.variance_m2, sigma_m**2)
    layers = derive(replace(map_, independent_m2=variance, relief_m2=0 * variance))
    inner = (slice(5, -5), slice(5, -5))
    roughness = np.sqrt(np.mean(np.square(layers.roughness_m[inner], dtype=float)))
    assert roughness == pytest.approx(layers.roughness_noise_m[inner].mean(), rel=0.02)
    doubled = derive(replace(map_, independent_m2=variance, relief_m2=variance))
    np.testing.assert_array_equal(doubled.roughness_noise_m, layers.roughness_noise_m)
    np.testing.assert_allclose(
        doubled.slope_sigma_rad, np.sqrt(2.0) * layers.slope_sigma_rad, rtol=1e-6
    )
    spread = np.std(layers.slope_rad[inner], dtype=float)
    assert spread == pytest.approx(layers.slope_sigma_rad[inner].mean(), rel=0.03)


def test_a_disc_holds_the_cells_within_its_radius() -> None:
    assert disc(0.1, 0.04).tolist() == [2, 2, 1]
    assert disc(0.1, 0.02).tolist() == [5, 4, 4, 4, 3, 0]
    assert disc(0.01, 0.04).tolist() == [1, 0]


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("plane_radius_m", 0.0, "plane_radius_m is 0.0; expected a number above 0"),
        ("critical_step_m", NAN, "critical_step_m is nan; expected a number above 0"),
        ("support_share", 1.5, "support_share is 1.5; expected at most 1"),
        ("combination", "best", "combination is 'best'; expected worst or mean"),
    ],
)
def test_settings_that_make_no_layer_are_refused(name: str, value: Any, message: str) -> None:
    with pytest.raises(MappingError, match=message):
        LayerSettings(**{name: value})


def test_parity_with_the_traversability_package(real_data: Path) -> None:
    """Every layer of the package's own map, 133 x 100 cells of 3 cm, from its heights.

    Measured: slope and roughness agree to 1e-5 in all but 2 of 13300 cells, the step in all, to
    1e-7. The two cells lie on an exact plane of 2 x 3 cells at the border, where the package
    takes the vertical for the normal (its covariance has no third rank) and this one the plane's.
    """
    folder = real_data / "traversability"
    with np.load(folder / "te_elevation_map.npz") as file:
        theirs = {name: file[name] for name in file.files}
    layers = derive(make_map(theirs["elevation"], resolution_m=float(theirs["res"])), PACKAGE)
    ours = {
        "traversability_slope": score(layers.slope_rad, PACKAGE.critical_slope_rad),
        "traversability_roughness": score(layers.roughness_m, PACKAGE.critical_roughness_m),
        "traversability_step": score(layers.supported_step_m, PACKAGE.critical_step_m),
        "traversability": layers.traversability,
    }
    for name, layer in ours.items():
        differs = np.argwhere(np.abs(layer - theirs[name]) > 1e-5)
        planes = [[117, 99], [118, 99]]
        assert differs.tolist() == ([] if name == "traversability_step" else planes), name
    for row, column in planes:
        assert theirs["traversability_slope"][row, column] == 1.0
        assert layers.roughness_m[row, column] < 1e-6
