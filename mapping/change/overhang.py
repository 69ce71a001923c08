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
Int32Array = NDArray[np.int32]
UInt32Array = NDArray[np.uint32]

# More than float32 rounds off a height above the camera.
_ROUNDING_M = 1e-4


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
    return int(
        drop_readings(
            readings.z_m,
            readings.margin_px,
            readings.ray_x,
            readings.ray_y,
            rotation,
            constants,
            floor,
        )
    )


@njit(cache=True, error_model="numpy")
def _is_level(
    z_m: Float32Array,
    margin: int,
    ray_x: Float32Array,
    ray_y: Float32Array,
    rotation: Float64Array,
    limit_m: float,
) -> bool:
    """Tell whether no reading is higher than this above the camera; without a branch, float32."""
    width = ray_x.shape[0]
    r20, r21, r22 = (
        np.float32(rotation[2, 0]),
        np.float32(rotation[2, 1]),
        np.float32(rotation[2, 2]),
    )
    limit = np.float32(limit_m)
    found = np.int32(0)
    for v in range(ray_y.shape[0]):
        row = z_m[v + margin][margin:][:width]
        rest = r21 * ray_y[v] + r22
        for u in range(width):
            high = row[u] * (r20 * ray_x[u] + rest) > limit
            found |= np.int32(high & (row[u] > np.float32(0.0)))
    return bool(found == 0)


@njit(cache=True, error_model="numpy")
def _lowest_reading(
    z_m: Float32Array, margin: int, ray_x: Float32Array, ray_y: Float32Array, rotation: Float64Array
) -> float:
    """Return the height of the lowest reading above the camera, infinite where there is none."""
    width = ray_x.shape[0]
    r20, r21, r22 = (
        np.float32(rotation[2, 0]),
        np.float32(rotation[2, 1]),
        np.float32(rotation[2, 2]),
    )
    # One minimum per column, in the lanes that the heights are computed in.
    lowest = np.full(width, np.inf, np.float32)
    for v in range(ray_y.shape[0]):
        row = z_m[v + margin][margin:][:width]
        rest = r21 * ray_y[v] + r22
        for u in range(width):
            height = row[u] * (r20 * ray_x[u] + rest)
            lower = (height < lowest[u]) & (row[u] > np.float32(0.0))
            lowest[u] = height if lower else lowest[u]
    return float(lowest.min())


@njit(cache=True, error_model="numpy")
def _lowest_floor(c: FrameConstants, floor: _Floor) -> float:
    """Return the height of the lowest confirmed cell of the window, infinite without any."""
    rows, columns = floor.elevation_m.shape
    lowest = np.inf
    for j in range(c.cells_y):
        row = (c.first_row + j) % rows
        column = c.first_column % columns
        for _ in range(c.cells_x):
            known = (floor.frames[row, column] >= floor.confirmed_frames) & (
                floor.pixels[row, column] >= floor.confirmed_pixels
            )
            height = floor.elevation_m[row, column] if known else np.inf
            lowest = height if height < lowest else lowest
            column = column + 1 if column + 1 < columns else 0
    return lowest


@njit(cache=True, error_model="numpy")
def _locate_row(
    row: Float32Array,
    ray_x: Float32Array,
    y: float,
    rotation: Float64Array,
    c: FrameConstants,
    cell: Int32Array,
    height_m: Float64Array,
) -> None:
    """Write the cell of the window under each reading, -1 where there is none, and its height."""
    per_m = 1.0 / c.cell_size_m
    x_rest = rotation[0, 1] * y + rotation[0, 2]
    y_rest = rotation[1, 1] * y + rotation[1, 2]
    z_rest = rotation[2, 1] * y + rotation[2, 2]
    for u in range(ray_x.shape[0]):
        z, x = float(row[u]), float(ray_x[u])
        column = (z * (rotation[0, 0] * x + x_rest) - c.corner_x_m) * per_m
        line = (z * (rotation[1, 0] * x + y_rest) - c.corner_y_m) * per_m
        inside = (column >= 0.0) & (column < c.cells_x) & (line >= 0.0) & (line < c.cells_y)
        inside &= z > 0.0
        # What is out of an integer's range is not converted.
        i = np.int32(column if inside else 0.0)
        j = np.int32(line if inside else 0.0)
        cell[u] = j * np.int32(c.cells_x) + i if inside else np.int32(-1)
        height_m[u] = z * (rotation[2, 0] * x + z_rest) + c.camera_z_m


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
) -> int:
    """Zero the readings above their cell's ceiling.

    No ceiling is lower than the clearance above all that is known. Where no reading reaches that,
    as on most ground, nothing else is computed.
    """
    lowest = min(
        _lowest_reading(z_m, margin, ray_x, ray_y, rotation), _lowest_floor(c, floor) - c.camera_z_m
    )
    if _is_level(z_m, margin, ray_x, ray_y, rotation, lowest + floor.clearance_m - _ROUNDING_M):
        return 0
    width = ray_x.shape[0]
    cells_m = np.full(c.cells_x * c.cells_y, np.inf)
    cell, height_m = np.empty(width, np.int32), np.empty(width)
    for v in range(ray_y.shape[0]):
        row = z_m[v + margin][margin:][:width]
        _locate_row(row, ray_x, float(ray_y[v]), rotation, c, cell, height_m)
        for u in range(width):
            if cell[u] >= 0:
                cells_m[cell[u]] = min(cells_m[cell[u]], height_m[u])
    _raise_to_ceiling(cells_m, c, floor)
    dropped = 0
    for v in range(ray_y.shape[0]):
        row = z_m[v + margin][margin:][:width]
        _locate_row(row, ray_x, float(ray_y[v]), rotation, c, cell, height_m)
        for u in range(width):
            if cell[u] >= 0 and height_m[u] > cells_m[cell[u]]:
                row[u] = 0.0
                dropped += 1
    return dropped
