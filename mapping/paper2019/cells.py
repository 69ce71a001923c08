"""The cells of a paper2019 map: height, 3 x 3 covariance, counts; they grow as the rover drives."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapping.cells.grid import CellWindow, megabytes
from mapping.errors import MappingError
from mapping.paper2019.equations import (
    fused_height_m,
    fused_variance_m2,
    moved_covariance_m2,
    new_covariance_m2,
)
from mapping.settings import MapSettings

Float64Array = NDArray[np.float64]


class PaperCells:
    """Arrays (rows = y, columns = x) over `extent`; a cell with frames = 0 is unknown."""

    def __init__(self, settings: MapSettings) -> None:
        self._settings = settings
        self.extent = CellWindow(0, 0, 0, 0)
        self.height_m = np.zeros((0, 0))
        self.covariance_m2 = np.zeros((0, 0, 3, 3))
        self.frames = np.zeros((0, 0), np.uint32)
        self.pixels = np.zeros((0, 0), np.uint32)
        self.last_ns = np.zeros((0, 0), np.int64)

    def cover(self, window: CellWindow) -> None:
        """Enlarge the arrays to hold a window.

        Raises:
            MappingError: the map would need more memory than the settings allow.
        """
        old = self.extent
        wanted = window if old.is_empty else old.union(window)
        need_mb = megabytes(wanted.cells_x, wanted.cells_y)
        if need_mb > self._settings.memory_limit_mb:
            raise MappingError(
                f"the map would need {need_mb:.1f} MB, the limit is "
                f"{self._settings.memory_limit_mb:.1f} MB; check the poses for jumps"
            )
        row, column = old.first_y - wanted.first_y, old.first_x - wanted.first_x
        place = (slice(row, row + old.cells_y), slice(column, column + old.cells_x))
        for name in ("height_m", "covariance_m2", "frames", "pixels", "last_ns"):
            array = getattr(self, name)
            larger = np.zeros((wanted.cells_y, wanted.cells_x, *array.shape[2:]), array.dtype)
            if not old.is_empty:
                larger[place] = array
            setattr(self, name, larger)
        self.extent = wanted

    def move(
        self, c_tr: Float64Array, rover_m: Float64Array, step_m2: Float64Array, yaw_rad2: float
    ) -> None:
        """Let every known cell's covariance grow by a motion of the rover (eq. 28)."""
        known = self.frames > 0
        points = np.stack([*self._centres_m(), self.height_m], axis=-1)[known]
        self.covariance_m2[known] = moved_covariance_m2(
            self.covariance_m2[known], c_tr, points - rover_m, step_m2, yaw_rad2
        )

    def update(
        self,
        window: CellWindow,
        height_m: Float64Array,
        pixel_m2: Float64Array,
        pixels: Float64Array,
        t_ns: int,
    ) -> int:
        """Update each cell with its pixels one after the other (eqs. 11-17); return the cells.

        n updates by pixels of equal variance v and mean h are one by h with the variance v / n.

        Args:
            window: cells of the arrays below, (cells_y, cells_x).
            height_m: mean of the pixels in a cell. pixel_m2: variance of each of them.
            pixels: how many there are; 0 = the cell is not seen.
            t_ns: when.
        """
        row, column = window.first_y - self.extent.first_y, window.first_x - self.extent.first_x
        rows, columns = np.nonzero(pixels > 0.0)
        here, place = (rows, columns), (rows + row, columns + column)
        measured_m2 = pixel_m2[here] / pixels[here]
        old = self.frames[place] > 0
        map_m, map_m2 = self.height_m[place], self.covariance_m2[(*place, 2, 2)]
        self.height_m[place] = np.where(
            old, fused_height_m(map_m, map_m2, height_m[here], measured_m2), height_m[here]
        )
        fused_m2 = np.where(old, fused_variance_m2(map_m2, measured_m2), measured_m2)
        self.covariance_m2[place] = new_covariance_m2(fused_m2, self._settings.resolution_m)
        self.frames[place] += np.uint32(1)
        self.pixels[place] += pixels[here].astype(np.uint32)
        self.last_ns[place] = t_ns
        return rows.size

    def _centres_m(self) -> tuple[Float64Array, Float64Array]:
        """Return x and y of every cell's centre, (rows, columns) each."""
        d, extent = self._settings.resolution_m, self.extent
        x = (np.arange(extent.first_x, extent.first_x + extent.cells_x) + 0.5) * d
        y = (np.arange(extent.first_y, extent.first_y + extent.cells_y) + 0.5) * d
        return tuple(np.meshgrid(x, y))
