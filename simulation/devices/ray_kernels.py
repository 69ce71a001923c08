"""First hits of rays on a triangulated height grid: exact, without optics.

A ray is followed through blocks of squares and, where it dips below a block's highest node,
through the block's squares. Over one triangle ray and ground are both linear, so the crossing is
solved, not searched. Horizontal coordinates are in squares from node [0, 0], heights in metres;
a ray is origin + s direction, and s is metres along the optical axis.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulation.terrain.height_grid import surface_plane

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]
Vector = tuple[float, float, float]

BLOCK_SQUARES = 8
_NOWHERE = -1.0
# A ray that stands on the edge of two squares is followed into the one that it enters.
_INTO_M = 1e-9


@njit(cache=True, error_model="numpy")
def block_maxima(height_m: Float32Array) -> Float32Array:
    """Return the highest node of every block of 16 x 16 squares, its edges included."""
    block_rows = (height_m.shape[0] - 2) // BLOCK_SQUARES + 1
    block_columns = (height_m.shape[1] - 2) // BLOCK_SQUARES + 1
    highest = np.empty((block_rows, block_columns), np.float32)
    for r in range(block_rows):
        for c in range(block_columns):
            r_first, c_first = r * BLOCK_SQUARES, c * BLOCK_SQUARES
            highest[r, c] = np.max(
                height_m[
                    r_first : r_first + BLOCK_SQUARES + 1, c_first : c_first + BLOCK_SQUARES + 1
                ]
            )
    return highest


@njit(cache=True, nogil=True, error_model="numpy")
def _within(origin: float, step: float, end: float) -> tuple[float, float]:
    """Return the ray parameters between which a coordinate lies in 0 ... end."""
    if step == 0.0:
        return (-np.inf, np.inf) if 0.0 <= origin <= end else (np.inf, -np.inf)
    at_zero, at_end = -origin / step, (end - origin) / step
    return min(at_zero, at_end), max(at_zero, at_end)


@njit(cache=True, nogil=True, error_model="numpy")
def _cell(origin: float, step: float, s: float, cells: int) -> int:
    """Return the cell of width 1 that a coordinate is in just after s."""
    return min(max(int(np.floor(origin + (s + _INTO_M) * step)), 0), cells - 1)


@njit(cache=True, nogil=True, error_model="numpy")
def _leaves(cell: int, origin: float, step: float) -> float:
    """Return the ray parameter at which a coordinate leaves a cell of width 1."""
    if step == 0.0:
        return np.inf
    return (cell + (1.0 if step > 0.0 else 0.0) - origin) / step


@njit(cache=True, nogil=True, error_model="numpy")
def _fall(a: float, b: float, s: float, s_end: float) -> float:
    """Return where between s and s_end the clearance a + b s becomes negative; -1 = nowhere."""
    if a + b * s_end >= 0.0:
        return _NOWHERE
    return max(-a / b, s) if b < 0.0 else s


@njit(cache=True, nogil=True, error_model="numpy")
def _hit_square(
    height_m: Float32Array, r: int, c: int, origin: Vector, ray: Vector, s: float, s_end: float
) -> float:
    """Return where a ray falls below the two triangles of a square; -1 = nowhere."""
    corner, beside = np.float64(height_m[r, c]), np.float64(height_m[r, c + 1])
    above, opposite = np.float64(height_m[r + 1, c]), np.float64(height_m[r + 1, c + 1])
    if origin[2] + min(s * ray[2], s_end * ray[2]) > max(max(corner, beside), max(above, opposite)):
        return _NOWHERE
    x, y = origin[0] - c, origin[1] - r
    # Clearances a + b s over the triangle where x > y and over the one where x < y.
    a_low = origin[2] - corner - x * (beside - corner) - y * (opposite - beside)
    b_low = ray[2] - ray[0] * (beside - corner) - ray[1] * (opposite - beside)
    a_up = origin[2] - corner - x * (opposite - above) - y * (above - corner)
    b_up = ray[2] - ray[0] * (opposite - above) - ray[1] * (above - corner)
    apart = ray[0] - ray[1]
    diagonal = (y - x) / apart if apart != 0.0 else np.inf
    if not s < diagonal < s_end:
        if x - y + 0.5 * (s + s_end) * apart >= 0.0:
            return _fall(a_low, b_low, s, s_end)
        return _fall(a_up, b_up, s, s_end)
    if apart > 0.0:
        a_low, b_low, a_up, b_up = a_up, b_up, a_low, b_low
    hit = _fall(a_low, b_low, s, diagonal)
    return hit if hit >= 0.0 else _fall(a_up, b_up, diagonal, s_end)


@njit(cache=True, nogil=True, error_model="numpy")
def _hit_block(
    height_m: Float32Array, origin: Vector, ray: Vector, s: float, s_end: float
) -> float:
    """Return where between s and s_end a ray falls below the ground; -1 = nowhere."""
    rows, columns = height_m.shape[0] - 1, height_m.shape[1] - 1
    c, r = _cell(origin[0], ray[0], s, columns), _cell(origin[1], ray[1], s, rows)
    while 0 <= c < columns and 0 <= r < rows:
        s_x, s_y = _leaves(c, origin[0], ray[0]), _leaves(r, origin[1], ray[1])
        s_next = max(min(s_x, s_y, s_end), s)
        hit = _hit_square(height_m, r, c, origin, ray, s, s_next)
        if hit >= 0.0 or s_next >= s_end:
            return hit
        if s_x <= s_y:
            c += 1 if ray[0] > 0.0 else -1
        else:
            r += 1 if ray[1] > 0.0 else -1
        s = s_next
    return _NOWHERE


@njit(cache=True, nogil=True, error_model="numpy")
def first_hit(
    height_m: Float32Array, highest: Float32Array, origin: Vector, ray: Vector, s_max: float
) -> float:
    """Return the parameter of a ray's first hit from above, at most s_max; -1 = none.

    Args:
        height_m: the nodes.
        highest: of the blocks, from `block_maxima`.
        origin, ray: in squares, squares and metres.
        s_max: end of the ray.
    """
    in_x, out_x = _within(origin[0], ray[0], height_m.shape[1] - 1.0)
    in_y, out_y = _within(origin[1], ray[1], height_m.shape[0] - 1.0)
    s, s_end = max(0.0, in_x, in_y), min(s_max, out_x, out_y)
    if not s < s_end:
        return _NOWHERE
    ground, _, _ = surface_plane(
        height_m, 0.0, 0.0, 1.0, origin[0] + s * ray[0], origin[1] + s * ray[1]
    )
    if not origin[2] + s * ray[2] >= ground:  # below, or not a number
        return _NOWHERE
    x, y = origin[0] / BLOCK_SQUARES, origin[1] / BLOCK_SQUARES
    step_x, step_y = ray[0] / BLOCK_SQUARES, ray[1] / BLOCK_SQUARES
    rows, columns = highest.shape
    c, r = _cell(x, step_x, s, columns), _cell(y, step_y, s, rows)
    while 0 <= c < columns and 0 <= r < rows:
        s_x, s_y = _leaves(c, x, step_x), _leaves(r, y, step_y)
        s_next = max(min(s_x, s_y, s_end), s)
        if origin[2] + min(s * ray[2], s_next * ray[2]) <= highest[r, c]:
            hit = _hit_block(height_m, origin, ray, s, s_next)
            if hit >= 0.0:
                return hit
        if s_next >= s_end:
            break
        if s_x <= s_y:
            c += 1 if step_x > 0.0 else -1
        else:
            r += 1 if step_y > 0.0 else -1
        s = s_next
    return _NOWHERE


@njit(cache=True, nogil=True, error_model="numpy")
def cast_image(
    height_m: Float32Array,
    highest: Float32Array,
    place: tuple[float, float, float],
    position_m: Float64Array,
    rotation: Float64Array,
    ray_x: Float64Array,
    ray_y: Float64Array,
    sun: Float64Array,
    z_max_m: float,
    z_m: Float64Array,
    incidence: Float64Array,
    sunlight: Float64Array,
) -> None:
    """Fill depth (0 = nothing hit) and the cosines to the view and to the sun of every pixel.

    Args:
        height_m, highest: the ground and its `block_maxima`.
        place: origin x, origin y and spacing of the ground, metres.
        position_m, rotation: camera in the world; optical frame to world.
        ray_x, ray_y: x/z of the columns and y/z of the rows in the optical frame.
        sun: (3,) unit vector towards the sun.
        z_max_m: end of the rays along the optical axis.
        z_m, incidence, sunlight: (rows, columns), filled.
    """
    x, y, spacing = place
    origin = ((position_m[0] - x) / spacing, (position_m[1] - y) / spacing, position_m[2])
    for v in range(ray_y.size):
        for u in range(ray_x.size):
            d_x = rotation[0, 0] * ray_x[u] + rotation[0, 1] * ray_y[v] + rotation[0, 2]
            d_y = rotation[1, 0] * ray_x[u] + rotation[1, 1] * ray_y[v] + rotation[1, 2]
            d_z = rotation[2, 0] * ray_x[u] + rotation[2, 1] * ray_y[v] + rotation[2, 2]
            ray = (d_x / spacing, d_y / spacing, d_z)
            s = first_hit(height_m, highest, origin, ray, z_max_m)
            if s < 0.0:
                z_m[v, u], incidence[v, u], sunlight[v, u] = 0.0, 1.0, 0.0
                continue
            _, g_x, g_y = surface_plane(
                height_m,
                0.0,
                0.0,
                spacing,
                (origin[0] + s * ray[0]) * spacing,
                (origin[1] + s * ray[1]) * spacing,
            )
            length = np.sqrt(1.0 + g_x * g_x + g_y * g_y)
            distance = np.sqrt(d_x * d_x + d_y * d_y + d_z * d_z)
            z_m[v, u] = s
            incidence[v, u] = max((g_x * d_x + g_y * d_y - d_z) / (length * distance), 0.0)
            sunlight[v, u] = max((sun[2] - g_x * sun[0] - g_y * sun[1]) / length, 0.0)
