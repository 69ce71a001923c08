import time

import numpy as np
import pytest

from simulation.errors import SimulationError
from simulation.terrain.ground_layout import FlatStart
from simulation.terrain.height_grid import HeightGrid
from simulation.terrain.lunar_features import (
    add_craters,
    add_rocks,
    crater_count,
    rock_count,
    rock_cover,
    sample_craters,
    sample_rocks,
)
from simulation.terrain.lunar_terrain import (
    DEFAULT_EXTENT,
    LARGEST_CRATER_M,
    PRESETS,
    LunarTerrain,
    lunar_terrain,
    smallest_feature_m,
)
from simulation.terrain.rough_ground import (
    COARSE_EXPONENT,
    FINE_EXPONENT,
    expected_rms_height_m,
    rough_ground,
)
from simulation.terrain.terrain_statistics import (
    TerrainStatistics,
    count_per_m2,
    terrain_statistics,
)

SMALL = (-2.0, 3.0, -2.0, 2.0)


@pytest.fixture(scope="module")
def terrains() -> dict[str, LunarTerrain]:
    return {preset: lunar_terrain(preset, 5) for preset in PRESETS}


@pytest.fixture(scope="module")
def bare_ground() -> TerrainStatistics:
    heights = rough_ground((1500, 1500), 0.02, np.radians(6.0), np.random.default_rng(1))
    return terrain_statistics(HeightGrid(0.0, 0.0, 0.02, heights.astype(np.float32)))


@pytest.mark.parametrize("preset", PRESETS)
def test_slopes_are_the_published_ones_at_both_baselines(
    terrains: dict[str, LunarTerrain], preset: str
) -> None:
    slopes = terrain_statistics(terrains[preset].grid).median_slope_rad
    wanted = PRESETS[preset]
    assert np.degrees(slopes[0.02]) == pytest.approx(wanted.slope_2cm_deg, rel=0.1)
    assert np.degrees(slopes[1.0]) == pytest.approx(wanted.slope_1m_deg, rel=0.15)


def test_bare_ground_has_the_published_exponents(bare_ground: TerrainStatistics) -> None:
    assert np.degrees(bare_ground.median_slope_rad[0.02]) == pytest.approx(6.0, rel=0.03)
    assert bare_ground.exponent(0.04, 0.2) == pytest.approx(FINE_EXPONENT, abs=0.04)
    assert bare_ground.exponent(0.4, 2.0) == pytest.approx(COARSE_EXPONENT, abs=0.07)


@pytest.mark.parametrize("window", [0.2, 0.5, 1.0, 2.0])
def test_rms_heights_in_windows_follow_from_the_spectrum(
    bare_ground: TerrainStatistics, window: float
) -> None:
    found = bare_ground.rms_height_m[window]
    assert found == pytest.approx(expected_rms_height_m(window, np.radians(6.0)), rel=0.1)


def test_rms_height_is_above_each_window_s_own_plane() -> None:
    x, y = np.meshgrid(np.arange(60.0), np.arange(40.0))
    checkers = np.where((x + y) % 2 == 0, 0.01, -0.01)
    grid = HeightGrid(0.0, 0.0, 0.1, (0.3 * x - 0.2 * y + checkers).astype(np.float32))
    assert terrain_statistics(grid).rms_height_m[2.0] == pytest.approx(0.01, rel=1e-3)


@pytest.mark.parametrize("preset", PRESETS)
def test_there_are_as_many_craters_and_rocks_as_published(
    terrains: dict[str, LunarTerrain], preset: str
) -> None:
    kind, terrain = PRESETS[preset], terrains[preset]
    area = 400.0
    for diameter, found in count_per_m2(terrain.craters[:, 2], (0.08, 0.2), area).items():
        wanted = crater_count(diameter, kind.crater_density)
        wanted -= crater_count(LARGEST_CRATER_M, kind.crater_density)
        assert abs(found - wanted) * area < 4.0 * np.sqrt(wanted * area)
    for diameter, found in count_per_m2(terrain.rocks[:, 2], (0.08, 0.12), area).items():
        wanted = rock_count(diameter, kind.rock_share)
        wanted -= rock_count(kind.largest_rock_m, kind.rock_share)
        # Those that would have stood on the start were taken away.
        assert abs(found - wanted) * area < 4.0 * np.sqrt(wanted * area) + 0.01 * wanted * area


def test_fresh_craters_are_a_hundredth_of_all() -> None:
    craters = sample_craters((0.0, 100.0, 0.0, 100.0), 0.2, (0.2, 4.0), np.random.default_rng(0))
    nearly_fresh = np.count_nonzero(craters[:, 3] > 0.75) / len(craters)
    assert nearly_fresh == pytest.approx((0.01**0.75 - 0.01) / 0.99, rel=0.15)


def test_rocks_cover_the_published_share() -> None:
    area, share = 200.0 * 200.0, 0.05
    rocks = sample_rocks((0.0, 200.0, 0.0, 200.0), share, (0.05, 2.0), np.random.default_rng(0))
    covered = float(np.sum(np.pi / 4.0 * rocks[:, 2] ** 2)) / area
    assert covered == pytest.approx(rock_cover(0.05, share) - rock_cover(2.0, share), rel=0.05)


def test_a_fresh_crater_has_its_depth_and_rim() -> None:
    heights = np.zeros((401, 401))
    add_craters(heights, (-2.0, -2.0), 0.01, np.array([[0.0, 0.0, 1.0, 1.0]]))
    assert heights[200, 200] == pytest.approx(0.06 - 0.25)
    assert heights.max() == pytest.approx(0.06, rel=0.01)
    assert heights[200, 250] == pytest.approx(0.06)
    assert heights[200, 326] == 0.0


def test_a_rock_has_its_height_and_covers_its_disc_s_area() -> None:
    heights = np.full((201, 201), 0.5)
    add_rocks(heights, (0.0, 0.0), 0.01, np.array([[1.0, 1.0, 0.4, 0.2, 0.7, 0.3]]))
    assert heights.max() == pytest.approx(0.7)
    assert np.count_nonzero(heights > 0.5) * 1e-4 == pytest.approx(np.pi * 0.04, rel=0.02)


def test_features_beyond_the_edge_are_cut_off() -> None:
    heights = np.zeros((11, 11))
    add_craters(heights, (0.0, 0.0), 0.1, np.array([[-0.3, 1.2, 1.0, 0.5]]))
    add_rocks(heights, (0.0, 0.0), 0.1, np.array([[1.2, -0.3, 1.0, 0.5, 1.0, 0.0]]))
    assert heights[10, 0] < 0.0 < heights[0, 10]


def test_the_start_is_level(terrains: dict[str, LunarTerrain]) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 100)
    for terrain in terrains.values():
        around = terrain.grid.height_at(0.75 * np.cos(angle), 0.75 * np.sin(angle))
        np.testing.assert_allclose(around, 0.0, atol=1e-6)
        assert terrain.grid.height_m.std() > 0.01


def test_same_seed_same_ground() -> None:
    """For another process see `tests/test_cli.py`, which simulates a drive in one."""
    one, again, other = (
        lunar_terrain("nominal", seed, extent=SMALL).grid.height_m.tobytes() for seed in (9, 9, 10)
    )
    assert one == again
    assert one != other


def test_a_million_nodes_take_less_than_a_second() -> None:
    start = time.process_time()
    terrain = lunar_terrain("rough", 2)
    assert terrain.grid.height_m.shape == (1001, 1001)
    assert time.process_time() - start < 1.0


def test_the_grid_covers_the_extent() -> None:
    assert lunar_terrain("smooth", 0).grid.extent == pytest.approx(DEFAULT_EXTENT)
    assert smallest_feature_m(0.02) == pytest.approx(0.08)


@pytest.mark.parametrize(
    ("preset", "seed", "extent", "spacing", "message"),
    [
        ("martian", 0, SMALL, 0.02, "expected one of smooth, nominal, rough"),
        ("smooth", -1, SMALL, 0.02, "seed -1"),
        ("smooth", 0, (1.0, 0.0, 0.0, 1.0), 0.02, "x_min < x_max"),
        ("smooth", 0, (0.0, np.inf, 0.0, 1.0), 0.02, "x_min < x_max"),
        ("smooth", 0, SMALL, 0.0, "positive spacing"),
        ("smooth", 0, (0.0, 1e6, 0.0, 1e6), 0.02, "at most 25000000 nodes"),
        ("smooth", 0, SMALL, 10.0, "at least 1 x 1"),
    ],
)
def test_impossible_grounds_are_refused(
    preset: str, seed: int, extent: tuple[float, float, float, float], spacing: float, message: str
) -> None:
    with pytest.raises(SimulationError, match=message):
        lunar_terrain(preset, seed, extent=extent, spacing_m=spacing)


def test_counts_need_an_area() -> None:
    with pytest.raises(SimulationError, match="area"):
        count_per_m2(np.ones(3), (0.1,), 0.0)


def test_a_coarse_grid_has_no_features_that_it_cannot_show() -> None:
    for spacing, craters in ((0.05, True), (1.5, False)):
        terrain = lunar_terrain("smooth", 0, extent=(-20.0, 20.0, -20.0, 20.0), spacing_m=spacing)
        assert len(terrain.rocks) == 0
        assert (len(terrain.craters) > 0) == craters


@pytest.mark.parametrize(("radius", "blend"), [(-1.0, 1.0), (1.0, 0.0)])
def test_the_start_must_be_a_disc(radius: float, blend: float) -> None:
    with pytest.raises(SimulationError, match="level start"):
        FlatStart(radius_m=radius, blend_m=blend)
