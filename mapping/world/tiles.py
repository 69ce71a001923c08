"""Which tiles a window of cells touches, and what two windows have in common."""

from __future__ import annotations

from collections.abc import Iterator

from mapping.cells.grid import CellWindow

TILE_CELLS = 128

Tile = tuple[int, int]
"""Column and row of a tile: tile (i, j) holds cells 128 i to 128 i + 127, and so for j."""

Place = tuple[slice, slice]
"""Rows and columns of a rectangle in arrays of cells."""


def window_of(tile: Tile) -> CellWindow:
    """Return the cells of a tile."""
    return CellWindow(tile[0] * TILE_CELLS, tile[1] * TILE_CELLS, TILE_CELLS, TILE_CELLS)


def tiles_of(window: CellWindow) -> list[Tile]:
    """Return the tiles that a window touches, row by row."""
    columns = range(
        window.first_x // TILE_CELLS, -(-(window.first_x + window.cells_x) // TILE_CELLS)
    )
    rows = range(window.first_y // TILE_CELLS, -(-(window.first_y + window.cells_y) // TILE_CELLS))
    return [(i, j) for j in rows for i in columns]


def shares(window: CellWindow) -> Iterator[tuple[Tile, Place, Place]]:
    """Yield each tile of a window, and where their common cells are in tile and window."""
    if window.is_empty:
        return
    for tile in tiles_of(window):
        whole = window_of(tile)
        common = window.intersection(whole)
        yield tile, place_in(whole, common), place_in(window, common)


def place_in(whole: CellWindow, part: CellWindow) -> Place:
    """Return the rows and columns of a part of a window in that window's arrays."""
    row, column = part.first_y - whole.first_y, part.first_x - whole.first_x
    return slice(row, row + part.cells_y), slice(column, column + part.cells_x)


def without(window: CellWindow, other: CellWindow) -> list[CellWindow]:
    """Return the cells that another window, as large or empty, does not hold, as rectangles."""
    common = window.intersection(other)
    if common.is_empty:
        return [] if window.is_empty else [window]
    upper = other.first_y <= window.first_y
    right = other.first_x <= window.first_x
    pieces = [
        CellWindow(
            window.first_x,
            common.first_y + common.cells_y if upper else window.first_y,
            window.cells_x,
            window.cells_y - common.cells_y,
        ),
        CellWindow(
            common.first_x + common.cells_x if right else window.first_x,
            common.first_y,
            window.cells_x - common.cells_x,
            common.cells_y,
        ),
    ]
    return [piece for piece in pieces if not piece.is_empty]
