"""Where cells live: a map that grows, and a window that scrolls with the rover.

Cells are numbered by integers over the whole terrain frame: cell (ix, iy) covers
x in [ix d, (ix + 1) d), y in [iy d, (iy + 1) d). Both grids keep their cells in arrays
(rows = y, columns = x) that wrap around: global cell (ix, iy) is at
[(iy - base_y) % rows, (ix - base_x) % columns].
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mapping.cells.cell_layers import BYTES_PER_CELL, CellLayers, copy_cells, empty_layers
from mapping.errors import MappingError
from mapping.motion.run_state import RunState, fresh_run
from mapping.settings import MapSettings

# A growing map is enlarged in steps of this many cells, so that it is seldom copied.
_GROWTH_CELLS = 64


@dataclass(frozen=True, slots=True)
class CellWindow:
    """A rectangle of cells: first column and row (global numbers) and its size in cells."""

    first_x: int
    first_y: int
    cells_x: int
    cells_y: int

    @property
    def is_empty(self) -> bool:
        """Whether it holds no cell."""
        return self.cells_x <= 0 or self.cells_y <= 0

    def intersection(self, other: CellWindow) -> CellWindow:
        """Return the cells that both hold; may be empty."""
        first_x = max(self.first_x, other.first_x)
        first_y = max(self.first_y, other.first_y)
        end_x = min(self.first_x + self.cells_x, other.first_x + other.cells_x)
        end_y = min(self.first_y + self.cells_y, other.first_y + other.cells_y)
        return CellWindow(first_x, first_y, max(end_x - first_x, 0), max(end_y - first_y, 0))

    def union(self, other: CellWindow) -> CellWindow:
        """Return the smallest rectangle that holds both."""
        first_x = min(self.first_x, other.first_x)
        first_y = min(self.first_y, other.first_y)
        end_x = max(self.first_x + self.cells_x, other.first_x + other.cells_x)
        end_y = max(self.first_y + self.cells_y, other.first_y + other.cells_y)
        return CellWindow(first_x, first_y, end_x - first_x, end_y - first_y)


def megabytes(rows: int, columns: int) -> float:
    """Return the memory that so many cells take."""
    return rows * columns * BYTES_PER_CELL / 1e6


class Cells(Protocol):
    """What a map is read out from."""

    @property
    def extent(self) -> CellWindow:
        """The cells that are held now."""

    def unrolled(self) -> CellLayers:
        """Return copies of the layers with row 0 = smallest y and column 0 = smallest x."""


class Grid(Cells, Protocol):
    """What the mapper needs of a grid."""

    @property
    def layers(self) -> CellLayers:
        """The arrays; they may be replaced by `prepare`."""

    def prepare(self, footprint: CellWindow, rover_x_m: float, rover_y_m: float) -> CellWindow:
        """Make room for a frame's footprint; return the part of it that the grid holds."""

    def position(self, window: CellWindow) -> tuple[int, int]:
        """Return (row, column) in the arrays of the window's first cell."""

    @property
    def run(self) -> RunState:
        """The run that its cells are from, as far as the grid keeps it; else a fresh one."""

    def keep(self, run: RunState, *, at_once: bool = False) -> None:
        """Bring all cells to disk, if the grid has a place there and it is time.

        Args:
            run: the run that the cells are from, after the frame that they are as of.
            at_once: whether it is time in any case.
        """


class GrowingGrid:
    """Keeps every cell that was ever seen; its arrays are enlarged as the rover drives."""

    def __init__(self, settings: MapSettings) -> None:
        self._limit_mb = settings.memory_limit_mb
        self._cell_size_m = settings.resolution_m
        self._extent = CellWindow(0, 0, 0, 0)
        self._layers = empty_layers(0, 0)

    @property
    def layers(self) -> CellLayers:
        """The arrays; row 0 is the smallest y."""
        return self._layers

    @property
    def extent(self) -> CellWindow:
        """The cells that the grid holds now."""
        return self._extent

    def prepare(
        self,
        footprint: CellWindow,
        rover_x_m: float,  # noqa: ARG002 - part of the protocol; this grid does not follow
        rover_y_m: float,  # noqa: ARG002
    ) -> CellWindow:
        """Enlarge the arrays to hold the footprint.

        Raises:
            MappingError: the map would need more memory than the settings allow.
        """
        wanted = footprint if self._extent.is_empty else self._extent.union(footprint)
        if wanted != self._extent:
            self._enlarge(_rounded_outwards(wanted))
        return footprint

    def position(self, window: CellWindow) -> tuple[int, int]:
        """Return (row, column) in the arrays of the window's first cell."""
        return window.first_y - self._extent.first_y, window.first_x - self._extent.first_x

    def unrolled(self) -> CellLayers:
        """Return copies of the layers."""
        return CellLayers._make(layer.copy() for layer in self._layers)

    @property
    def run(self) -> RunState:
        """A fresh one: the cells are gone with the run."""
        return fresh_run()

    def keep(self, run: RunState, *, at_once: bool = False) -> None:
        """Do nothing: this grid lives in memory."""

    def _enlarge(self, extent: CellWindow) -> None:
        need_mb = megabytes(extent.cells_x, extent.cells_y)
        if need_mb > self._limit_mb:
            size_x, size_y = extent.cells_x * self._cell_size_m, extent.cells_y * self._cell_size_m
            raise MappingError(
                f"the map would grow to {size_x:.0f} m x {size_y:.0f} m ({need_mb:.1f} MB), the "
                f"limit is {self._limit_mb:.1f} MB; check the poses for jumps, use a coarser "
                "resolution or a scrolling grid"
            )
        layers = empty_layers(extent.cells_y, extent.cells_x)
        old = self._extent
        row, column = old.first_y - extent.first_y, old.first_x - extent.first_x
        place = (slice(row, row + old.cells_y), slice(column, column + old.cells_x))
        copy_cells(self._layers, (slice(None), slice(None)), layers, place)
        self._layers, self._extent = layers, extent


def _rounded_outwards(window: CellWindow) -> CellWindow:
    """Return the window enlarged to multiples of the growth step."""
    step = _GROWTH_CELLS
    first_x, first_y = window.first_x // step * step, window.first_y // step * step
    end_x = -(-(window.first_x + window.cells_x) // step) * step
    end_y = -(-(window.first_y + window.cells_y) // step) * step
    return CellWindow(first_x, first_y, end_x - first_x, end_y - first_y)


class ScrollingGrid:
    """A square window centred on the rover; what leaves it is forgotten, nothing is copied."""

    def __init__(self, settings: MapSettings) -> None:
        """Make the window, not yet placed.

        Raises:
            MappingError: it would need more memory than the settings allow.
        """
        self._cell_size_m = settings.resolution_m
        self._cells = round(settings.window_m / settings.resolution_m)
        need_mb = megabytes(self._cells, self._cells)
        if need_mb > settings.memory_limit_mb:
            raise MappingError(
                f"a window of {settings.window_m:g} m with cells of {settings.resolution_m:g} m "
                f"needs {need_mb:.1f} MB, the limit is {settings.memory_limit_mb:.1f} MB; use a "
                "smaller window or a coarser resolution"
            )
        self._extent: CellWindow | None = None
        self._layers = empty_layers(self._cells, self._cells)

    @property
    def layers(self) -> CellLayers:
        """The arrays; global cell (ix, iy) is at [iy % cells, ix % cells]."""
        return self._layers

    @property
    def extent(self) -> CellWindow:
        """The cells that the window covers now."""
        return self._extent or CellWindow(0, 0, 0, 0)

    def prepare(self, footprint: CellWindow, rover_x_m: float, rover_y_m: float) -> CellWindow:
        """Centre the window on the rover and clear what has come into it."""
        half = self._cells // 2
        extent = CellWindow(
            math.floor(rover_x_m / self._cell_size_m) - half,
            math.floor(rover_y_m / self._cell_size_m) - half,
            self._cells,
            self._cells,
        )
        self._move(extent)
        return footprint.intersection(extent)

    def position(self, window: CellWindow) -> tuple[int, int]:
        """Return (row, column) in the arrays of the window's first cell."""
        return window.first_y % self._cells, window.first_x % self._cells

    def unrolled(self) -> CellLayers:
        """Return copies of the layers with row 0 = smallest y and column 0 = smallest x."""
        row, column = self.position(self.extent)
        shift = (-row, -column)
        return CellLayers._make(np.roll(layer, shift, axis=(0, 1)) for layer in self._layers)

    @property
    def run(self) -> RunState:
        """A fresh one: the cells are gone with the run."""
        return fresh_run()

    def keep(self, run: RunState, *, at_once: bool = False) -> None:
        """Do nothing: this grid lives in memory."""

    def _move(self, extent: CellWindow) -> None:
        """Cover other cells; what enters is unknown."""
        if self._extent is not None:
            self._clear(1, self._extent.first_x, extent.first_x)
            self._clear(0, self._extent.first_y, extent.first_y)
        self._extent = extent

    def _clear(self, axis: int, old_first: int, new_first: int) -> None:
        """Forget the cells that enter along one axis (0 = y, 1 = x)."""
        moved = new_first - old_first
        if moved == 0:
            return
        count = min(abs(moved), self._cells)
        entering = new_first + self._cells - count if moved > 0 else new_first
        places = np.arange(entering, entering + count) % self._cells
        for layer in self._layers:
            if axis == 0:
                layer[places, :] = 0
            else:
                layer[:, places] = 0


def make_grid(settings: MapSettings) -> Grid:
    """Return the grid that the settings ask for."""
    return ScrollingGrid(settings) if settings.grid == "scrolling" else GrowingGrid(settings)
