"""The scrolling window over a world: what leaves it is kept on disk, and comes back from there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapping.cells.cell_layers import CellLayers, copy_cells, empty_layers
from mapping.cells.grid import CellWindow, ScrollingGrid
from mapping.motion.run_state import RunState
from mapping.settings import MapSettings
from mapping.world.tile_store import TileStore
from mapping.world.tiles import without
from mapping.world.world_cells import WorldCells

_ALL = (slice(None), slice(None))


class WorldGrid(ScrollingGrid):
    """A scrolling grid that forgets nothing.

    Everything is saved, as after one frame, whenever the window has moved on by a fourth of its
    edge: a crash loses no more than what was seen since.
    """

    def __init__(self, settings: MapSettings, store: TileStore) -> None:
        """Make the window over the cells in a store, where the run before has left it.

        Raises:
            MappingError: it would need more memory than the settings allow, or a tile is damaged.
        """
        super().__init__(settings)
        self._store = store
        self._world = WorldCells(store)
        self._saved: CellWindow | None = None
        if self.run.pose is not None:
            self.prepare(CellWindow(0, 0, 0, 0), self.run.rover.x_m, self.run.rover.y_m)

    @property
    def run(self) -> RunState:
        """The run that the cells are from, as of the last save."""
        return self._store.run

    def keep(self, run: RunState, *, at_once: bool = False) -> None:
        """Bring all cells to disk, if the window has moved on far enough.

        Raises:
            MappingError: the disk does not take them.
        """
        extent = self.extent
        if extent.is_empty:
            return
        saved = self._saved = self._saved or extent
        moved = max(abs(extent.first_x - saved.first_x), abs(extent.first_y - saved.first_y))
        if at_once or moved >= max(extent.cells_x // 4, 1):
            self._world.put(extent, self.unrolled())
            self._world.save(extent, run)
            self._saved = extent

    def _move(self, extent: CellWindow) -> None:
        """Cover other cells; what enters is as it was when it left.

        Raises:
            MappingError: a tile is damaged.
        """
        old = self.extent
        if extent == old:
            return
        for piece in without(old, extent):
            self._world.put(piece, self._block(piece))
        super()._move(extent)
        for piece in without(extent, old):
            copy_cells(self._world.take(piece), _ALL, self.layers, self._places(piece))

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
