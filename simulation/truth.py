"""What the mapper must not know: the true terrain on the cells of a map, and what was visible."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulation.errors import SimulationError

Float64Array = NDArray[np.float64]

# A cell is visible when at least so many undisturbed rays within the camera's range met it.
_VISIBLE_RAYS = 4


@dataclass(frozen=True, slots=True)
class Truth:
    """True heights on square cells.

    Attributes:
        x_m, y_m: cell centres, increasing.
        height_m: (y, x) terrain height at the centres.
        visible: (y, x) cells that at least four undisturbed rays within the camera's range met.
    """

    x_m: Float64Array
    y_m: Float64Array
    height_m: Float64Array
    visible: NDArray[np.bool_]


class SeenCells:
    """Counts the rays that met each cell; cells are multiples of their size from the origin.

    Args:
        cell_size_m: edge of a cell.
    """

    def __init__(self, cell_size_m: float) -> None:
        if not cell_size_m > 0.0:
            raise SimulationError(f"cells of {cell_size_m} m; expected more than 0")
        self._size_m = cell_size_m
        self._cells: list[NDArray[np.int64]] = []
        self._rays: list[NDArray[np.int64]] = []

    def add(self, points_m: Float64Array) -> None:
        """Count (N, 2 or more) world points."""
        cells = np.floor(points_m[:, :2] / self._size_m).astype(np.int64)
        if cells.shape[0] == 0:
            return
        first = cells.min(axis=0)
        columns, rows = cells.max(axis=0) - first + 1
        flat = (cells[:, 1] - first[1]) * columns + cells[:, 0] - first[0]
        rays = np.bincount(flat, minlength=int(rows * columns))
        met = np.flatnonzero(rays)
        self._cells.append(np.column_stack([met % columns, met // columns]) + first)
        self._rays.append(rays[met])

    def truth(self, height_m: Callable[[Float64Array, Float64Array], Float64Array]) -> Truth:
        """Return the truth on the rectangle of all cells that were met.

        Args:
            height_m: the height at (x, y), which broadcast.

        Raises:
            SimulationError: no cell was met.
        """
        cells = np.concatenate([np.empty((0, 2), np.int64), *self._cells])
        if cells.shape[0] == 0:
            raise SimulationError("the camera saw no ground within its range; let it look down")
        first = cells.min(axis=0)
        columns, rows = cells.max(axis=0) - first + 1
        rays = np.zeros((rows, columns), np.int64)
        np.add.at(
            rays, (cells[:, 1] - first[1], cells[:, 0] - first[0]), np.concatenate(self._rays)
        )
        x_m = (first[0] + np.arange(columns) + 0.5) * self._size_m
        y_m = (first[1] + np.arange(rows) + 0.5) * self._size_m
        heights = height_m(x_m[np.newaxis, :], y_m[:, np.newaxis])
        return Truth(x_m, y_m, heights, rays >= _VISIBLE_RAYS)
