"""Cells that nobody has seen although the camera looked their way: something nearer hid them.

Two neighbouring pixels whose readings lie far apart are almost one ray, which ends at the nearer
point and, a pixel further, at the farther one. What lies between the two is behind the nearer one.
The same distance between neighbours arises where ground is seen at a low angle, but there it is
like that of the next neighbours: it counts as a jump when it exceeds three times theirs, noise
and 1.5 cells.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.cells.update_constants import FrameConstants
from mapping.change.visibility import Sight
from mapping.measurement import Readings, View

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]
UInt8Array = NDArray[np.uint8]

_TIMES_NEIGHBOURS = 3.0
# Of a reading seen head-on; there are two, ground at a low angle is noisier, and pixels are many.
_SIGMAS = 6.0
_CELLS = 1.5


def mark_hidden(
    readings: Readings, view: View, constants: FrameConstants, sight: Sight, hidden: UInt8Array
) -> None:
    """Set `hidden` to 1 for the cells between the readings on both sides of each jump in depth.

    Args:
        readings: a loaded frame.
        view: where it was taken from.
        constants: the frame's geometry, with its window of cells.
        sight: how well the camera measures.
        hidden: (rows, columns) a layer of the map; cells that were seen may be marked as well.
    """
    rotation = np.ascontiguousarray(view.T_terrain_sensor.rotation)
    mark_jumps(
        readings.z_m,
        readings.margin_px,
        readings.ray_x,
        readings.ray_y,
        rotation,
        constants,
        sight,
        hidden,
    )


@njit(inline="always")
def _is_jump(before: float, a: float, b: float, after: float, d: float, s: Sight) -> bool:
    """Tell whether b follows a in a jump; before and after are their neighbours, 0 = none."""
    if (a <= 0.0) | (b <= 0.0):
        return False
    far = max(a, b)
    excess = far - s.noise_reference_m
    sigma = (
        s.noise_offset_m + s.noise_quadratic_per_m * excess * excess + s.quantum_per_m * far * far
    )
    beside = abs(a - before) if before > 0.0 else 0.0
    beyond = abs(after - b) if after > 0.0 else 0.0
    usual = _TIMES_NEIGHBOURS * max(beside, beyond)
    return bool(abs(a - b) > usual + _SIGMAS * sigma + _CELLS * d)


@njit(inline="always")
def _mark_between(
    z_a: float,
    z_b: float,
    x: float,
    y: float,
    c_ts: Float64Array,
    c: FrameConstants,
    hidden: UInt8Array,
) -> None:
    """Mark the cells under the ray (x, y, 1) from one distance to the other."""
    rows, columns = hidden.shape
    run_x = c_ts[0, 0] * x + c_ts[0, 1] * y + c_ts[0, 2]
    run_y = c_ts[1, 0] * x + c_ts[1, 1] * y + c_ts[1, 2]
    length = abs(z_b - z_a) * np.sqrt(run_x * run_x + run_y * run_y)
    steps = int(2.0 * length / c.cell_size_m) + 1
    for k in range(1, steps):
        z = z_a + (z_b - z_a) * k / steps
        i = int(np.floor((z * run_x - c.corner_x_m) / c.cell_size_m))
        j = int(np.floor((z * run_y - c.corner_y_m) / c.cell_size_m))
        if (i >= 0) & (j >= 0) & (i < c.cells_x) & (j < c.cells_y):
            hidden[(c.first_row + j) % rows, (c.first_column + i) % columns] = 1


@njit(inline="always")
def _after(z_m: Float32Array, row: int, column: int) -> float:
    """Return a reading, 0 beyond the margin."""
    inside = (row < z_m.shape[0]) & (column < z_m.shape[1])
    return float(z_m[row, column]) if inside else 0.0


@njit(cache=True, error_model="numpy")
def _find_far_neighbours(
    row: Float32Array, below: Float32Array, right: Float32Array, apart_m: float, found: UInt8Array
) -> None:
    """Mark the readings whose neighbour is so far away; no branch, so that it is vectorised."""
    apart = np.float32(apart_m)
    for u in range(found.size):
        is_far = (abs(right[u] - row[u]) > apart) & (right[u] > np.float32(0.0))
        is_far |= (abs(below[u] - row[u]) > apart) & (below[u] > np.float32(0.0))
        found[u] = is_far & (row[u] > np.float32(0.0))


@njit(cache=True, error_model="numpy")
def mark_jumps(
    z_m: Float32Array,
    margin: int,
    ray_x: Float32Array,
    ray_y: Float32Array,
    c_ts: Float64Array,
    c: FrameConstants,
    s: Sight,
    hidden: UInt8Array,
) -> None:
    """Look at each pixel's neighbours to the right and below; `z_m` has a margin of zeros."""
    width = ray_x.shape[0]
    far = np.empty(width, np.uint8)
    apart_m = _CELLS * c.cell_size_m
    for v in range(ray_y.shape[0]):
        row = v + margin
        y = float(ray_y[v])
        here, below_row = z_m[row][margin:][:width], z_m[row + 1][margin:][:width]
        # A little less: float32 rounds, and the exact test comes later.
        _find_far_neighbours(here, below_row, z_m[row][margin + 1 :][:width], 0.999 * apart_m, far)
        for u in range(width):
            if far[u] == 0:
                continue
            column = u + margin
            z = float(z_m[row, column])
            right = float(z_m[row, column + 1])
            below = float(z_m[row + 1, column])
            x = float(ray_x[u])
            before, above = float(z_m[row, column - 1]), float(z_m[row - 1, column])
            after = _after(z_m, row, column + 2)
            if abs(right - z) > apart_m and _is_jump(before, z, right, after, c.cell_size_m, s):
                _mark_between(z, right, x, y, c_ts, c, hidden)
            after = _after(z_m, row + 2, column)
            if abs(below - z) > apart_m and _is_jump(above, z, below, after, c.cell_size_m, s):
                _mark_between(z, below, x, y, c_ts, c, hidden)
