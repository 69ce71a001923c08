import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from simulation.errors import SimulationError
from simulation.terrain.height_grid import HeightGrid

PLACE = st.floats(0.0, 1.0)


def one_square(corner: float, beside: float, above: float, opposite: float) -> HeightGrid:
    heights = np.array([[corner, beside], [above, opposite]], np.float32)
    return HeightGrid(2.0, -1.0, 0.5, heights)


def test_the_square_is_split_from_its_corner_to_the_opposite_one() -> None:
    grid = one_square(0.0, 1.0, 3.0, 0.0)
    assert grid.height_at([2.25, 2.5, 2.0, 2.25], [-0.75, -1.0, -0.5, -1.0]).tolist() == [
        0.0,
        1.0,
        3.0,
        0.5,
    ]


@given(PLACE, PLACE, st.tuples(*[st.floats(-5.0, 5.0, width=32)] * 4))
def test_heights_are_the_mean_of_the_triangles_nodes(
    fx: float, fy: float, nodes: tuple[float, float, float, float]
) -> None:
    corner, beside, above, opposite = nodes
    grid = one_square(*nodes)
    if fx >= fy:
        expected = (1 - fx) * corner + (fx - fy) * beside + fy * opposite
    else:
        expected = (1 - fy) * corner + (fy - fx) * above + fx * opposite
    assert grid.height_at(2.0 + 0.5 * fx, -1.0 + 0.5 * fy) == pytest.approx(expected, abs=1e-9)


def test_rows_go_along_y_and_columns_along_x() -> None:
    grid = HeightGrid(-1.0, 5.0, 0.1, np.arange(12, dtype=np.float32).reshape(3, 4))
    assert grid.extent == pytest.approx((-1.0, -0.7, 5.0, 5.2))
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    np.testing.assert_allclose(grid.height_at(x, y), grid.height_m, atol=1e-5)


def test_normals_and_slopes_of_a_tilted_plane() -> None:
    x = 0.25 * np.arange(9)
    grid = HeightGrid(0.0, 0.0, 0.25, np.tile(0.75 * x, (9, 1)).astype(np.float32))
    places = np.array([0.1, 1.0, 1.9])
    np.testing.assert_allclose(grid.normal_at(places, 0.3), [[-0.6, 0.0, 0.8]] * 3, atol=1e-6)
    np.testing.assert_allclose(grid.slope(places, 0.3), np.arctan(0.75), atol=1e-6)


def test_there_is_nothing_outside() -> None:
    grid = one_square(1.0, 1.0, 1.0, 1.0)
    x, y = [1.99, 2.51, 2.2, 2.2, np.nan], [-0.8, -0.8, -1.01, -0.49, -0.8]
    assert np.isnan(grid.height_at(x, y)).all()
    assert np.isnan(grid.slope(x, y)).all()
    assert np.isnan(grid.normal_at(x, y)).all()


def test_the_grid_owns_its_heights() -> None:
    mine = np.zeros((3, 3), np.float32)
    grid = HeightGrid(0.0, 0.0, 1.0, mine)
    mine[0, 0] = 7.0
    assert grid.height_at(0.0, 0.0) == 0.0
    with pytest.raises(ValueError, match="read-only"):
        grid.height_m[0, 0] = 1.0


@pytest.mark.parametrize(
    ("spacing", "heights", "message"),
    [
        (1.0, np.zeros((1, 5)), "2 x 2"),
        (1.0, np.zeros(5), "2 x 2"),
        (0.0, np.zeros((3, 3)), "spacing of 0.0 m"),
        (np.nan, np.zeros((3, 3)), "spacing"),
        (1.0, np.array([[0.0, np.nan], [0.0, 0.0]]), "1 nodes without height"),
    ],
)
def test_what_is_no_surface_is_refused(
    spacing: float, heights: NDArray[np.float64], message: str
) -> None:
    with pytest.raises(SimulationError, match=message):
        HeightGrid(0.0, 0.0, spacing, heights.astype(np.float32))


def test_the_origin_must_be_finite() -> None:
    with pytest.raises(SimulationError, match="origin"):
        HeightGrid(np.inf, 0.0, 1.0, np.zeros((2, 2), np.float32))
