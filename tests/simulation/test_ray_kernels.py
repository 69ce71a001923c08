import numpy as np
import pytest

from simulation.devices.ray_kernels import BLOCK_SQUARES, block_maxima, first_hit
from simulation.terrain.height_grid import HeightGrid

SAMPLES = 4000


Vector = tuple[float, float, float]


def check_against_dense_samples(grid: HeightGrid, origin: Vector, ray: Vector, end: float) -> bool:
    """Compare a hit with heights along the ray, in a grid of unit squares; return if it hit."""
    hit = first_hit(grid.height_m, block_maxima(grid.height_m), origin, ray, end)
    s = np.linspace(0.0, end, SAMPLES)
    x, y, z = (start + s * step for start, step in zip(origin, ray, strict=True))
    clearance = z - grid.height_at(x, y)
    over_ground = np.flatnonzero(np.isfinite(clearance))
    if over_ground.size == 0 or clearance[over_ground[0]] < 0.0:
        return False  # beside the ground, or below it from its edge on
    if hit < 0.0:
        assert np.nanmin(clearance) > -1e-3
        return False
    at_hit = [start + hit * step for start, step in zip(origin, ray, strict=True)]
    assert at_hit[2] - grid.height_at(at_hit[0], at_hit[1]) == pytest.approx(0.0, abs=1e-6)
    assert np.nanmin(clearance[s < hit], initial=0.0) > -1e-9
    return True


def test_hits_are_on_the_ground_and_nothing_is_hit_before() -> None:
    random = np.random.default_rng(4)
    hits = 0
    for _ in range(300):
        shape = random.integers(2, 60, 2)
        grid = HeightGrid(0.0, 0.0, 1.0, random.normal(0.0, 0.6, shape).astype(np.float32))
        x, y = random.uniform(-5.0, shape[1] + 5.0), random.uniform(-5.0, shape[0] + 5.0)
        target = random.uniform(0.0, 1.0, 2) * (shape[::-1] - 1)
        origin = (float(x), float(y), float(random.uniform(2.5, 8.0)))
        ray = (float(target[0] - x), float(target[1] - y), -origin[2])
        hits += check_against_dense_samples(grid, origin, ray, 1.5)
    assert hits > 250


@pytest.mark.parametrize(
    "ray",
    [(0.0, 0.0, -1.0), (1.0, 0.0, -0.2), (0.0, -1.0, -0.2), (1.0, 1.0, -0.2), (-1.0, -1.0, -0.3)],
)
@pytest.mark.parametrize("start", [(20.0, 20.0), (20.0, 20.5), (20.5, 20.0), (16.0, 16.0)])
def test_rays_along_edges_and_diagonals_find_the_ground(
    start: tuple[float, float], ray: Vector
) -> None:
    random = np.random.default_rng(5)
    grid = HeightGrid(0.0, 0.0, 1.0, random.normal(0.0, 0.3, (41, 41)).astype(np.float32))
    assert check_against_dense_samples(grid, (*start, 2.0), ray, 14.0)


def test_a_level_ray_hits_only_what_stands_in_its_way() -> None:
    heights = np.zeros((9, 40), np.float32)
    heights[:, 30] = 1.0
    heights.flags.writeable = False  # as a grid's; others would be compiled for again
    highest = block_maxima(heights)
    assert first_hit(heights, highest, (2.0, 4.2, 0.5), (1.0, 0.0, 0.0), 99.0) == 27.5
    assert first_hit(heights, highest, (2.0, 4.2, 1.5), (1.0, 0.0, 0.0), 99.0) < 0.0
    assert first_hit(heights, highest, (2.0, 4.2, 0.5), (1.0, 0.0, 0.0), 27.0) < 0.0
    assert first_hit(heights, highest, (2.0, 4.2, 0.5), (-1.0, 0.0, 0.0), 99.0) < 0.0


def test_nothing_is_seen_from_below_or_beside() -> None:
    heights = np.zeros((20, 20), np.float32)
    heights.flags.writeable = False
    highest = block_maxima(heights)
    assert first_hit(heights, highest, (5.0, 5.0, -0.1), (0.1, 0.0, 1.0), 99.0) < 0.0
    assert first_hit(heights, highest, (-5.0, 5.0, -0.1), (1.0, 0.0, -0.01), 99.0) < 0.0
    assert first_hit(heights, highest, (-5.0, 5.0, 1.0), (0.0, 1.0, -1.0), 99.0) < 0.0
    assert first_hit(heights, highest, (np.nan, 5.0, 1.0), (0.0, 1.0, -1.0), 99.0) < 0.0


@pytest.mark.parametrize("shape", [(2, 2), (17, 18), (33, 16), (50, 3)])
def test_block_maxima_cover_their_edges(shape: tuple[int, int]) -> None:
    heights = np.random.default_rng(1).normal(size=shape).astype(np.float32)
    heights.flags.writeable = False
    highest = block_maxima(heights)
    for r, c in np.ndindex(*highest.shape):
        rows = slice(r * BLOCK_SQUARES, (r + 1) * BLOCK_SQUARES + 1)
        columns = slice(c * BLOCK_SQUARES, (c + 1) * BLOCK_SQUARES + 1)
        assert highest[r, c] == heights[rows, columns].max()
    squares = np.array(highest.shape) * BLOCK_SQUARES
    assert np.all(squares >= np.array(shape) - 1)
    assert np.all(squares - BLOCK_SQUARES < np.array(shape) - 1)
