"""What hangs over the ground so high that the rover passes beneath it: a table top, a branch.

A map with one height per cell cannot hold both surfaces: their mean is neither, and taking each
in turn flickers. The rule here is that the lower surface is the ground. A reading that is more
than `overhang_clearance_m` above the lowest surface known in its cell is dropped: the lowest is
the lower of this frame's lowest reading and the cell's height, if that is confirmed. A cell of
which nothing but the upper surface was seen keeps it, until readings of the ground below replace
it as any second hypothesis does; after that the upper one never comes back.

What stands on the ground is not lost: its flank has readings below the clearance, and those
stay. That holds for a clearance above the camera's height; below that, the top of an obstacle may
be seen without its flank.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.cells.cell_layers import CellLayers
from mapping.cells.update_constants import FrameConstants
from mapping.measurement import Readings, View
from mapping.settings import MapSettings

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]
UInt32Array = NDArray[np.uint32]


class _Floor(NamedTuple):
    """The map's heights (rows, columns), and what makes one of them a floor."""

    elevation_m: Float64Array
    frames: UInt32Array
    pixels: UInt32Array
    confirmed_frames: int
    confirmed_pixels: int
    clearance_m: float


def drop_overhangs(
    readings: Readings,
    view: View,
    constants: FrameConstants,
    layers: CellLayers,
    settings: MapSettings,
) -> int:
    """Drop the readings of a frame that lie higher above their cell than the clearance.

    Args:
        readings: a loaded frame, changed in place.
        view: where it was taken from.
        constants: the frame's geometry, with its window of cells.
        layers: the map's cells.
        settings: clearance, and what confirms a cell.

    Returns:
        How many were dropped.
    """
    floor = _Floor(
        layers.elevation_m,
        layers.frames,
        layers.pixels,
        settings.confirmed_frames,
        settings.confirmed_pixels,
        settings.overhang_clearance_m,
    )
    rotation = np.ascontiguousarray(view.T_terrain_sensor.rotation)
    cells = np.full(constants.cells_x * constants.cells_y, np.inf)
    return int(
        drop_readings(
            readings.z_m,
            readings.margin_px,
            readings.ray_x,
            readings.ray_y,
            rotation,
            constants,
            floor,
            cells,
        )
    )


@njit(inline="always")
def _locate(
    z: float, x: float, y: float, rotation: Float64Array, c: FrameConstants
) -> tuple[int, float]:
    """Return the cell of the window under a reading, -1 outside, and its height in T."""
    column = (z * (rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2])) - c.corner_x_m
    line = (z * (rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2])) - c.corner_y_m
    height = z * (rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2]) + c.camera_z_m
    i = int(np.floor(column / c.cell_size_m))
    j = int(np.floor(line / c.cell_size_m))
    inside = (i >= 0) & (j >= 0) & (i < c.cells_x) & (j < c.cells_y)
    return (j * c.cells_x + i if inside else -1), height


@njit(inline="always")
def _raise_to_ceiling(lowest_m: Float64Array, c: FrameConstants, floor: _Floor) -> None:
    """Turn each cell's lowest reading into the height above which readings are dropped."""
    rows, columns = floor.elevation_m.shape
    for j in range(c.cells_y):
        row = (c.first_row + j) % rows
        for i in range(c.cells_x):
            column = (c.first_column + i) % columns
            known = (floor.frames[row, column] >= floor.confirmed_frames) & (
                floor.pixels[row, column] >= floor.confirmed_pixels
            )
            k = j * c.cells_x + i
            if known:
                lowest_m[k] = min(lowest_m[k], floor.elevation_m[row, column])
            lowest_m[k] += floor.clearance_m


@njit(cache=True, error_model="numpy")
def drop_readings(
    z_m: Float32Array,
    margin: int,
    ray_x: Float32Array,
    ray_y: Float32Array,
    rotation: Float64Array,
    c: FrameConstants,
    floor: _Floor,
    cells_m: Float64Array,
) -> int:
    """Zero the readings above their cell's ceiling; `cells_m` comes in as infinity."""
    for v in range(ray_y.shape[0]):
        for u in range(ray_x.shape[0]):
            z = float(z_m[v + margin, u + margin])
            if z > 0.0:
                cell, height = _locate(z, float(ray_x[u]), float(ray_y[v]), rotation, c)
                if cell >= 0:
                    cells_m[cell] = min(cells_m[cell], height)
    _raise_to_ceiling(cells_m, c, floor)
    dropped = 0
    for v in range(ray_y.shape[0]):
        for u in range(ray_x.shape[0]):
            z = float(z_m[v + margin, u + margin])
            if z > 0.0:
                cell, height = _locate(z, float(ray_x[u]), float(ray_y[v]), rotation, c)
                if cell >= 0 and height > cells_m[cell]:
                    z_m[v + margin, u + margin] = 0.0
                    dropped += 1
    return dropped
