"""Growing and scrolling grids against a dictionary of cells."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapping.cells.cell_layers import BYTES_PER_CELL, empty_layers
from mapping.cells.grid import CellWindow, Grid, GrowingGrid, ScrollingGrid, make_grid
from mapping.errors import MappingError
from mapping.settings import MapSettings

Cells = dict[tuple[int, int], int]

CELL_M = 0.05
WINDOW_CELLS = 12
SMALL = MapSettings(grid="scrolling", resolution_m=CELL_M, window_m=WINDOW_CELLS * CELL_M)
LARGE = MapSettings(grid="scrolling", resolution_m=CELL_M, window_m=400 * CELL_M)

steps = st.tuples(st.integers(-9, 9), st.integers(-9, 9))
walks = st.lists(steps | st.tuples(st.integers(-99, 99), st.just(0)), min_size=1, max_size=12)
corners = st.tuples(st.integers(-100_000, 100_000), st.integers(-100_000, 100_000))


def _visit(grid: Grid, x: int, y: int, mark: int) -> CellWindow:
    """Stand in cell (x, y), see 7 x 5 cells beside it, and write a mark into all of them."""
    footprint = CellWindow(x - 2, y + 1, 7, 5)
    window = grid.prepare(footprint, (x + 0.5) * CELL_M, (y + 0.5) * CELL_M)
    row, column = grid.position(window)
    rows, columns = grid.layers.frames.shape
    for j in range(window.cells_y):
        for i in range(window.cells_x):
            place = (row + j) % rows, (column + i) % columns
            for layer in grid.layers:
                layer[place] = mark
    return window


def _cells(grid: Grid) -> Cells:
    """Return the marked cells by global column and row; all layers of a cell agree."""
    layers, extent = grid.unrolled(), grid.extent
    for layer in layers:
        np.testing.assert_array_equal(layer, layers.frames)
    rows, columns = np.nonzero(layers.frames)
    return {
        (extent.first_x + int(i), extent.first_y + int(j)): int(layers.frames[j, i])
        for j, i in zip(rows, columns, strict=True)
    }


def _mark(cells: Cells, window: CellWindow, mark: int) -> None:
    for j in range(window.cells_y):
        for i in range(window.cells_x):
            cells[window.first_x + i, window.first_y + j] = mark


def _inside(window: CellWindow, cell: tuple[int, int]) -> bool:
    x, y = cell[0] - window.first_x, cell[1] - window.first_y
    return 0 <= x < window.cells_x and 0 <= y < window.cells_y


@given(corners, walks)
def test_a_scrolling_window_loses_exactly_what_leaves_it(
    start: tuple[int, int], walk: Sequence[tuple[int, int]]
) -> None:
    grid, cells = ScrollingGrid(SMALL), Cells()
    x, y = start
    for mark, (dx, dy) in enumerate(walk, start=1):
        x, y = x + dx, y + dy
        seen = _visit(grid, x, y, mark)
        extent = CellWindow(x - 6, y - 6, WINDOW_CELLS, WINDOW_CELLS)
        assert grid.extent == extent
        assert seen == CellWindow(x - 2, y + 1, 7, 5).intersection(extent)
        cells = {cell: value for cell, value in cells.items() if _inside(extent, cell)}
        _mark(cells, seen, mark)
        assert _cells(grid) == cells


def test_there_and_back_everything_that_stayed_inside_is_kept() -> None:
    grid = ScrollingGrid(SMALL)
    _visit(grid, 0, 0, 1)
    grid.prepare(CellWindow(0, 0, 1, 1), 4.5 * CELL_M, 0.5 * CELL_M)
    grid.prepare(CellWindow(0, 0, 1, 1), 0.5 * CELL_M, 0.5 * CELL_M)
    # Columns -2 to 4 were seen; the window went to columns -2 to 9 and back.
    assert set(_cells(grid)) == {(x, y) for x in range(-2, 5) for y in range(1, 6)}
    grid.prepare(CellWindow(0, 0, 1, 1), 5.5 * CELL_M, 0.5 * CELL_M)
    grid.prepare(CellWindow(0, 0, 1, 1), 0.5 * CELL_M, 0.5 * CELL_M)
    assert set(_cells(grid)) == {(x, y) for x in range(-1, 5) for y in range(1, 6)}


def test_a_cell_that_comes_back_remembers_no_second_hypothesis() -> None:
    grid = ScrollingGrid(SMALL)
    _visit(grid, 0, 0, 3)
    for x in (50, 0):
        grid.prepare(CellWindow(0, 0, 1, 1), (x + 0.5) * CELL_M, 0.5 * CELL_M)
    assert all(not layer.any() for layer in grid.layers)


def test_a_footprint_outside_the_window_is_empty() -> None:
    grid = ScrollingGrid(SMALL)
    window = grid.prepare(CellWindow(100, 100, 5, 5), 0.0, 0.0)
    assert window.is_empty
    assert (window.cells_x, window.cells_y) == (0, 0)


@pytest.mark.parametrize("cells", [11, 12])
def test_the_rover_is_in_the_middle_of_the_window(cells: int) -> None:
    settings = MapSettings(grid="scrolling", resolution_m=CELL_M, window_m=cells * CELL_M)
    grid = ScrollingGrid(settings)
    assert grid.extent.is_empty
    grid.prepare(CellWindow(0, 0, 1, 1), -0.01, 0.02)
    half = cells // 2
    assert grid.extent == CellWindow(-1 - half, -half, cells, cells)


@given(corners, walks)
def test_a_growing_map_loses_nothing(
    start: tuple[int, int], walk: Sequence[tuple[int, int]]
) -> None:
    grid, cells = GrowingGrid(MapSettings(resolution_m=CELL_M)), Cells()
    x, y = start
    for mark, (dx, dy) in enumerate(walk, start=1):
        x, y = x + dx, y + dy
        seen = _visit(grid, x, y, mark)
        assert seen == CellWindow(x - 2, y + 1, 7, 5)
        _mark(cells, seen, mark)
        assert _cells(grid) == cells
        assert grid.extent.first_x % 64 == grid.extent.cells_x % 64 == 0


@given(corners, st.lists(steps, min_size=1, max_size=12))
def test_both_hold_the_same_while_the_window_is_large(
    start: tuple[int, int], walk: Sequence[tuple[int, int]]
) -> None:
    growing, scrolling = GrowingGrid(MapSettings(resolution_m=CELL_M)), ScrollingGrid(LARGE)
    x, y = start
    for mark, (dx, dy) in enumerate(walk, start=1):
        x, y = x + dx, y + dy
        assert _visit(growing, x, y, mark) == _visit(scrolling, x, y, mark)
    assert _cells(growing) == _cells(scrolling) != {}


def test_what_is_read_out_is_a_copy() -> None:
    for grid in (GrowingGrid(MapSettings(resolution_m=CELL_M)), ScrollingGrid(SMALL)):
        _visit(grid, 0, 0, 5)
        before = _cells(grid)
        for layer in grid.unrolled():
            layer[:] = 0
        assert _cells(grid) == before


def test_a_map_beyond_the_memory_limit_is_refused_and_nothing_is_lost() -> None:
    settings = MapSettings(resolution_m=CELL_M, memory_limit_mb=4 * 64 * 64 * BYTES_PER_CELL / 1e6)
    grid = GrowingGrid(settings)
    _visit(grid, 10, 10, 1)
    _visit(grid, 100, 10, 2)
    before = _cells(grid)
    reason = r"grow to 16 m x 3 m \(1\.3 MB\), the limit is 1\.0 MB; check the poses for jumps"
    with pytest.raises(MappingError, match=reason):
        _visit(grid, 270, 10, 3)
    assert _cells(grid) == before
    _visit(grid, 90, 60, 3)


def test_a_jump_to_the_other_end_of_the_world_is_refused_at_once() -> None:
    grid = GrowingGrid(MapSettings())
    grid.prepare(CellWindow(0, 0, 9, 9), 0.0, 0.0)
    with pytest.raises(MappingError, match="check the poses for jumps"):
        grid.prepare(CellWindow(2_500_000_000, -2_500_000_000, 9, 9), 1e8, -1e8)


def test_a_window_beyond_the_memory_limit_is_refused() -> None:
    settings = MapSettings(grid="scrolling", resolution_m=0.001, window_m=100.0)
    reason = r"a window of 100 m with cells of 0\.001 m needs .* MB, the limit is 4096\.0 MB"
    with pytest.raises(MappingError, match=reason):
        make_grid(settings)


def test_the_settings_choose_the_grid() -> None:
    assert isinstance(make_grid(SMALL), ScrollingGrid)
    assert isinstance(make_grid(MapSettings()), GrowingGrid)


def test_the_size_of_a_cell_counts_every_layer() -> None:
    layers = empty_layers(10, 7)
    assert sum(layer.nbytes for layer in layers) == 70 * BYTES_PER_CELL


@given(
    st.builds(CellWindow, *[st.integers(-20, 20)] * 2, *[st.integers(1, 15)] * 2),
    st.builds(CellWindow, *[st.integers(-20, 20)] * 2, *[st.integers(1, 15)] * 2),
)
def test_intersection_and_union_are_those_of_sets(a: CellWindow, b: CellWindow) -> None:
    def cells(window: CellWindow) -> set[tuple[int, int]]:
        marked = Cells()
        _mark(marked, window, 1)
        return set(marked)

    assert cells(a.intersection(b)) == cells(a) & cells(b)
    assert a.intersection(b).is_empty == (not cells(a) & cells(b))
    both = a.union(b)
    assert cells(a) | cells(b) <= cells(both)
    assert both.first_x == min(a.first_x, b.first_x)
    assert both.first_y + both.cells_y == max(a.first_y + a.cells_y, b.first_y + b.cells_y)
