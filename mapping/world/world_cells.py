"""The cells of a world that are in memory: tiles around the window, and all since the last save."""

from __future__ import annotations

import numpy as np

from mapping.cells.cell_layers import CellLayers, copy_cells, empty_layers
from mapping.cells.grid import CellWindow
from mapping.motion.run_state import RunState
from mapping.world.tile_store import TileStore
from mapping.world.tiles import TILE_CELLS, Place, Tile, shares, tiles_of


class WorldCells:
    """Takes blocks of cells and gives them back.

    After a save the tiles that touch the window, or a ring of one tile around it, are in memory, so
    that a rover that turns on the spot does not make the disk work; until the next save those that
    the window comes to are added, because a save is of everything that has changed.
    """

    def __init__(self, store: TileStore) -> None:
        self._store = store
        self._tiles: dict[Tile, CellLayers] = {}
        self._changed: set[Tile] = set()

    def put(self, window: CellWindow, layers: CellLayers) -> None:
        """Take a block of cells; layers (window.cells_y, window.cells_x)."""
        for tile, inside, outside in shares(window):
            known = self._tile(tile)
            if _differ(layers, outside, known, inside):
                copy_cells(layers, outside, known, inside)
                self._changed.add(tile)

    def take(self, window: CellWindow) -> CellLayers:
        """Return a block of cells as it was last put; 0 where it never was."""
        layers = empty_layers(window.cells_y, window.cells_x)
        for tile, inside, outside in shares(window):
            copy_cells(self._tile(tile), inside, layers, outside)
        return layers

    def save(self, window: CellWindow, run: RunState) -> None:
        """Write every tile that has changed; drop those farther than one tile from the window.

        Args:
            window: the cells that are at work.
            run: the run that all cells are from, as of now.

        Raises:
            MappingError: the disk does not take them.
        """
        self._store.save({tile: self._tiles[tile] for tile in sorted(self._changed)}, run)
        self._changed.clear()
        wide = CellWindow(
            window.first_x - TILE_CELLS,
            window.first_y - TILE_CELLS,
            window.cells_x + 2 * TILE_CELLS,
            window.cells_y + 2 * TILE_CELLS,
        )
        for tile in self._tiles.keys() - set(tiles_of(wide)):
            del self._tiles[tile]

    def _tile(self, tile: Tile) -> CellLayers:
        if tile not in self._tiles:
            self._tiles[tile] = self._store.read(tile)
        return self._tiles[tile]


def _differ(some: CellLayers, here: Place, others: CellLayers, there: Place) -> bool:
    """Tell whether any layer of the cells at the two places differs."""
    pairs = zip(some._asdict().values(), others._asdict().values(), strict=True)
    return any(not np.array_equal(one[here], other[there]) for one, other in pairs)
