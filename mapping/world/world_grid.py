"""The scrolling window over a world: what leaves it is kept on disk, and comes back from there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapping.cells.cell_layers import CellLayers, copy_cells, empty_layers
from mapping.cells.grid import CellWindow, ScrollingGrid
from mapping.settings import MapSettings
from mapping.world.tile_store import TileStore
from mapping.world.tiles import without
from mapping.world.world_cells import WorldCells

_ALL = (slice(None), slice(None))


class WorldGrid(ScrollingGrid):
    """A scrolling grid that forgets nothing.

    Whenever the window has moved on by a fourth of its edge, everything in it is saved too: a crash
    loses no more than what was seen since.
    """

    def __init__(self, settings: MapSettings, store: TileStore) -> None:
        """Make the window, not yet placed, over the cells in a store.

        Raises:
            MappingError: it would need more memory than the settings allow.
        """
        super().__init__(settings)
        self._world = WorldCells(store)
        self._saved: CellWindow | None = None

    def save(self) -> None:
        """Bring all cells to disk.

        Raises:
            MappingError: the disk does not take them.
        """
        self._world.put(self.extent, self.unrolled())
        self._world.flush()
        self._saved = self.extent

    def _move(self, extent: CellWindow) -> None:
        """Cover other cells; what enters is as it was when it left.

        Raises:
            MappingError: the store cannot be read or written.
        """
        old = self.extent
        if extent == old:
            return
        for piece in without(old, extent):
            self._world.put(piece, self._block(piece))
        super()._move(extent)
        for piece in without(extent, old):
            copy_cells(self._world.take(piece), _ALL, self.layers, self._places(piece))
        self._world.keep(extent)
        self._save_now_and_then(extent)

    def _save_now_and_then(self, extent: CellWindow) -> None:
        saved = self._saved = self._saved or extent
        moved = max(abs(extent.first_x - saved.first_x), abs(extent.first_y - saved.first_y))
        if moved >= max(extent.cells_x // 4, 1):
            self.save()

    def _block(self, window: CellWindow) -> CellLayers:
        block = empty_layers(window.cells_y, window.cells_x)
        copy_cells(self.layers, self._places(window), block, _ALL)
        return block

    def _places(self, window: CellWindow) -> tuple[NDArray[np.intp], ...]:
        """Return an index of the window's cells in the arrays, which wrap around."""
        rows = np.arange(window.first_y, window.first_y + window.cells_y)
        columns = np.arange(window.first_x, window.first_x + window.cells_x)
        edge = self.layers.frames.shape[0]
        return np.ix_(rows % edge, columns % edge)
