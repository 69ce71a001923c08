"""Visibility clean-up: a surface that later rays have passed through is no longer there.

The update only looks at cells that a frame has readings in. What such a frame says of the others
is in its rays: one that runs through a cell, below its surface, and ends beyond it contradicts
the cell. Instead of walking along 300,000 rays, one ray is cast to each cell and looked up in the
depth image.

A cell without a reading in the frame is seen through when the rays to four points all end beyond
it: middle, left and right end of the cell, lowered by 3 sigma of cell and view and by what the
surface may slope within the cell; and the middle of its surface. "Beyond" is 1.5 cells and 3 sigma
of the reading. A reading before or in the cell, or none at all, is no evidence. A thin obstacle
survives: it has readings of its own whenever it is in view, and those go through the gate and the
second hypothesis.

Each such frame counts one, each frame with a reading in the cell takes one back; at
`seen_through_frames` the cell is forgotten, with all its layers: nothing is known of the ground
that lies below until it is seen.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from drivers.samples import CameraIntrinsics
from mapping.cells.cell_layers import CellLayers
from mapping.cells.update_constants import FrameConstants
from mapping.measurement import View
from mapping.noise import DepthNoiseModel

Float64Array = NDArray[np.float64]
UInt16Array = NDArray[np.uint16]
Int64Array = NDArray[np.int64]

_SIGMAS = 3.0
_CELLS_BEYOND = 1.5


class Sight(NamedTuple):
    """Where a depth image was taken and how well it measures.

    fx_px .. cy_px: the camera's. r20, r21: elements of C_TS that `FrameConstants` lacks.
    bias_*: corrected reading = z - (bias_m + bias_slope z + bias_quadratic_per_m z^2). noise_*,
    quantum_per_m: axial sigma head-on, see `mapping.noise`. limit: frames that forget a cell.
    """

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    r20: float
    r21: float
    bias_m: float
    bias_slope: float
    bias_quadratic_per_m: float
    noise_offset_m: float
    noise_quadratic_per_m: float
    noise_reference_m: float
    quantum_per_m: float
    limit: int


def sight_of(
    camera: CameraIntrinsics,
    noise: DepthNoiseModel,
    view: View,
    seen_through_frames: int,
) -> Sight:
    """Return what `clear_seen_through` needs to know of a frame's camera."""
    return Sight(
        camera.fx_px,
        camera.fy_px,
        camera.cx_px,
        camera.cy_px,
        float(view.T_terrain_sensor.rotation[2, 0]),
        float(view.T_terrain_sensor.rotation[2, 1]),
        noise.bias_m,
        noise.bias_slope,
        noise.bias_quadratic_per_m,
        noise.axial_offset_m,
        noise.axial_quadratic_per_m,
        noise.axial_reference_m,
        noise.quantum_per_m,
        seen_through_frames,
    )


def clear_seen_through(
    depth_mm: UInt16Array,
    sums: Float64Array,
    constants: FrameConstants,
    sight: Sight,
    layers: CellLayers,
) -> int:
    """Forget the cells that enough frames have seen through; return how many.

    Args:
        depth_mm: (height, width) the raw image: readings too far to be mapped are evidence too.
        sums: (cells, 4) the frame's sums over its window, not yet fused.
        constants: the frame's geometry, with that window.
        sight: the camera.
        layers: the map's cells; `seen_through` counts, cleared cells become 0 in every layer.
    """
    places = np.empty((constants.cells_x * constants.cells_y, 2), np.int64)
    plain = np.require(depth_mm, requirements=["C", "A", "W"])  # one kernel, not one per kind
    found = int(look_through(plain, sums, constants, sight, layers, places))
    rows, columns = places[:found].T
    for layer in layers:
        layer[rows, columns] = 0
    return found


@njit(inline="always")
def _ends_beyond(depth_mm: UInt16Array, u: float, v: float, z: float, d: float, s: Sight) -> bool:
    """Tell whether the ray at pixel (u, v) has ended beyond a point at distance z, cells d wide."""
    height, width = depth_mm.shape
    column = int(np.floor(u + 0.5))
    row = int(np.floor(v + 0.5))
    if (column < 0) | (row < 0) | (column >= width) | (row >= height):
        return False
    raw = depth_mm[row, column] * 1e-3
    reading = raw - (s.bias_m + raw * (s.bias_slope + raw * s.bias_quadratic_per_m))
    excess = reading - s.noise_reference_m
    sigma = (
        s.noise_offset_m
        + s.noise_quadratic_per_m * excess * excess
        + s.quantum_per_m * reading * reading
    )
    return bool(raw > 0.0 and reading - z > _CELLS_BEYOND * d + _SIGMAS * sigma)


@njit(inline="always")
def _doubt_m(
    layers: CellLayers, row: int, column: int, x: float, y: float, c: FrameConstants
) -> float:
    """Return by how much the surface at (x, y) from the camera may be lower than it seems.

    Both the cell and this view may be wrong: pose (bounded from above by 2 (zz + r^2 (aa + bb))),
    mount and noise; and the cell's middle may lie below the cell's mean where the ground slopes.
    """
    run2 = (x + c.lever_x_m) ** 2 + (y + c.lever_y_m) ** 2
    pose = 2.0 * (c.pose_zz + run2 * (c.pose_aa + c.pose_bb))
    mount = c.mount_rad * c.mount_rad * (x * x + y * y)
    cell = (
        float(layers.variance_m2[row, column])
        + float(layers.systematic_a_m[row, column]) ** 2
        + float(layers.systematic_b_m[row, column]) ** 2
        + float(layers.systematic_c_m[row, column]) ** 2
        + float(layers.systematic_bias_m[row, column]) ** 2
    )
    slope = _SIGMAS * np.sqrt(max(float(layers.relief_m2[row, column]), 0.0))
    return float(_SIGMAS * np.sqrt(cell + pose + mount) + min(slope, c.cell_size_m))


@njit(inline="always")
def _is_seen_through(
    depth_mm: UInt16Array,
    x: float,
    y: float,
    rise: float,
    doubt: float,
    c: FrameConstants,
    s: Sight,
) -> bool:
    """Tell whether all rays to the cell at (x, y, rise) from the camera end beyond it."""
    z = c.r02 * x + c.r12 * y + c.r22 * rise
    if z < c.range_min_m:
        return False
    u = s.cx_px + s.fx_px * (c.r00 * x + c.r10 * y + s.r20 * rise) / z
    v = s.cy_px + s.fy_px * (c.r01 * x + c.r11 * y + s.r21 * rise) / z
    d = c.cell_size_m
    if not _ends_beyond(depth_mm, u, v, z, d, s):
        return False
    # The nearest pixel's ray runs up to half a pixel higher than the one that is meant.
    low = rise - doubt - 0.5 * z / s.fy_px
    z = c.r02 * x + c.r12 * y + c.r22 * low
    if z < c.range_min_m:
        return False
    u = s.cx_px + s.fx_px * (c.r00 * x + c.r10 * y + s.r20 * low) / z
    v = s.cy_px + s.fy_px * (c.r01 * x + c.r11 * y + s.r21 * low) / z
    half = 0.5 * d * s.fx_px / z
    return (
        _ends_beyond(depth_mm, u, v, z, d, s)
        and _ends_beyond(depth_mm, u - half, v, z, d, s)
        and _ends_beyond(depth_mm, u + half, v, z, d, s)
    )


@njit(cache=True, error_model="numpy")
def look_through(
    depth_mm: UInt16Array,
    sums: Float64Array,
    c: FrameConstants,
    s: Sight,
    layers: CellLayers,
    places: Int64Array,
) -> int:
    """Count the frame in `seen_through`; fill (row, column) of the cells that reach the limit."""
    rows, columns = layers.elevation_m.shape
    found = 0
    for j in range(c.cells_y):
        row = (c.first_row + j) % rows
        y = c.corner_y_m + (j + 0.5) * c.cell_size_m
        for i in range(c.cells_x):
            column = (c.first_column + i) % columns
            if layers.frames[row, column] == 0:
                continue
            counted = layers.seen_through[row, column]
            if sums[j * c.cells_x + i, 3] > 0.0:
                layers.seen_through[row, column] = max(counted, 1) - 1
                continue
            x = c.corner_x_m + (i + 0.5) * c.cell_size_m
            rise = float(layers.elevation_m[row, column]) - c.camera_z_m
            doubt = _doubt_m(layers, row, column, x, y, c)
            if not _is_seen_through(depth_mm, x, y, rise, doubt, c, s):
                continue
            layers.seen_through[row, column] = counted + 1
            if counted + 1 >= s.limit:
                places[found, 0] = row
                places[found, 1] = column
                found += 1
    return found
