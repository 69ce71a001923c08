"""The per-pixel loops: depth image in, sums per cell out (numba, cached, no fastmath).

Each image row is taken in two passes. The first has no branch and no reduction, so that the
compiler turns it into vector instructions; every pixel's numbers are plain IEEE float32 and do not
depend on the vector width. The second adds the row to the cells, pixel by pixel from left to
right. The order of every sum is therefore fixed: same frame, same bits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]
Int32Array = NDArray[np.int32]

# Columns of the per-cell sums.
SUM_WEIGHT, SUM_WEIGHT_HEIGHT, SUM_WEIGHT_HEIGHT2, SUM_PIXELS = range(4)

# cos(84 deg): mapping.noise.INCIDENCE_LIMIT_RAD.
_COS_LIMIT = np.float32(0.10452846326765347)
_HALF_PI = np.float32(1.5707963267948966)
# No single reading is better than 10 um; keeps the weight finite where a ray runs level.
_MIN_VARIANCE_M2 = np.float32(1e-10)
_ONE = np.float32(1.0)
_ZERO = np.float32(0.0)
# acos(c) = sqrt(1 - c) (a0 + a1 c + a2 c^2 + a3 c^3), |error| <= 6.7e-5 rad.
# Abramowitz & Stegun, Handbook of Mathematical Functions, 4.4.45.
_A0 = np.float32(1.5707288)
_A1 = np.float32(-0.2121144)
_A2 = np.float32(0.0742610)
_A3 = np.float32(-0.0187293)


class RangeConstants(NamedTuple):
    """Raw millimetres to corrected metres: z - (b0 + b1 z + b2 z^2), 0 outside [min, max]."""

    bias_m: np.float32
    bias_slope: np.float32
    bias_quadratic_per_m: np.float32
    range_min_m: np.float32
    range_max_m: np.float32


class FocalConstants(NamedTuple):
    """Focal lengths of the image, and 1 / focal length of the sensor's 640 px wide image."""

    x_px: np.float32
    y_px: np.float32
    inverse_sensor_px: np.float32


class NoiseConstants(NamedTuple):
    """Coefficients of `mapping.noise.DepthNoiseModel`; quantum_variance = k^2 / 12."""

    c0: np.float32
    c1: np.float32
    c2: np.float32
    c3: np.float32
    quantum_variance: np.float32
    lateral_offset: np.float32
    lateral_angle: np.float32


class ViewConstants(NamedTuple):
    """Where the camera is, relative to the corner of the window of cells.

    rXY: rows of C_TS; height is relative to the camera, x and y in cells from the window's corner.
    """

    r00: np.float32
    r01: np.float32
    r02: np.float32
    r10: np.float32
    r11: np.float32
    r12: np.float32
    r20: np.float32
    r21: np.float32
    r22: np.float32
    corner_x_cells: np.float32
    corner_y_cells: np.float32
    cells_per_m: np.float32
    cells_x: int
    cells_y: int


@njit(cache=True, error_model="numpy")
def ranges_from_millimetres(
    depth_mm: NDArray[np.uint16], c: RangeConstants, margin: int, z_m: Float32Array
) -> int:
    """Fill the inside of `z_m` (height + 2 margin, width + 2 margin); return the valid pixels.

    The margin of zeros lets the gradient look beyond the image's edge without a branch.
    """
    height, width = depth_mm.shape
    # Counted per column, in the lanes that the ranges are computed in: twice as fast as one sum.
    valid = np.zeros(width, np.float32)
    for v in range(height):
        raw_mm = depth_mm[v]
        row = z_m[v + margin][margin:][:width]
        for u in range(width):
            # A quotient is rounded once: 3300 mm is the float32 of 3.3, as the range limit is.
            raw = np.float32(raw_mm[u]) / np.float32(1000.0)
            z = raw - (c.bias_m + raw * (c.bias_slope + raw * c.bias_quadratic_per_m))
            inside = (raw_mm[u] > 0) & (z >= c.range_min_m) & (z <= c.range_max_m)
            row[u] = z if inside else _ZERO
            valid[u] += _ONE if inside else _ZERO
    readings = 0
    for u in range(width):
        readings += int(valid[u])
    return readings


@njit(inline="always")
def _gradient(
    ahead: np.float32, here: np.float32, behind: np.float32, half: np.float32
) -> np.float32:
    """Return dz per pixel over +-k pixels; one-sided beside a hole, 0 between two holes.

    `half` is 1 / (2 k).
    """
    has_ahead = ahead > _ZERO
    has_behind = behind > _ZERO
    a = ahead if has_ahead else here
    b = behind if has_behind else here
    scale = half if has_ahead & has_behind else half + half
    return (a - b) * scale


@njit(inline="always")
def _angle_ratio(
    z: np.float32, x: np.float32, y: np.float32, slope_x: np.float32, slope_y: np.float32
) -> np.float32:
    """Return theta / (pi/2 - theta) for the angle between the ray (x, y, 1) and the normal.

    slope: dz per pixel times focal length. The normal is (-slope_x, -slope_y, depth_term), and
    normal . (x, y, 1) = z.
    """
    depth_term = z + x * slope_x + y * slope_y
    normal2 = slope_x * slope_x + slope_y * slope_y + depth_term * depth_term
    cosine = z / np.sqrt(normal2 * (_ONE + x * x + y * y))
    cosine = min(max(cosine, _COS_LIMIT), _ONE)
    angle = np.sqrt(_ONE - cosine) * (_A0 + cosine * (_A1 + cosine * (_A2 + cosine * _A3)))
    ratio: np.float32 = angle / (_HALF_PI - angle)
    return ratio


@njit(inline="always")
def _height_variance(
    z: np.float32,
    t: np.float32,
    rise: np.float32,
    ray2: np.float32,
    inverse_focal: np.float32,
    noise: NoiseConstants,
) -> np.float32:
    """Return sigma_z^2 (h/z)^2 + sigma_L^2 (1 - (e.ray)^2); t = angle ratio, rise = h/z.

    The axial error moves the point along its ray, the lateral error perpendicular to it.
    """
    excess = z - noise.c2
    axial = noise.c0 + noise.c1 * excess * excess + noise.c3 / np.sqrt(z) * t * t
    z2 = z * z
    axial2 = axial * axial + noise.quantum_variance * z2 * z2
    lateral = (noise.lateral_offset + noise.lateral_angle * t) * z * inverse_focal
    variance: np.float32 = axial2 * rise * rise + lateral * lateral * (_ONE - rise * rise / ray2)
    return variance


@njit(inline="always")
def _cell_of(z: np.float32, x: np.float32, y: np.float32, view: ViewConstants) -> np.int32:
    """Return the window's cell under the point z (x, y, 1); -1 outside."""
    cells = z * view.cells_per_m
    column = view.corner_x_cells + cells * (view.r00 * x + view.r01 * y + view.r02)
    line = view.corner_y_cells + cells * (view.r10 * x + view.r11 * y + view.r12)
    inside = (
        (column >= _ZERO)
        & (column < np.float32(view.cells_x))
        & (line >= _ZERO)
        & (line < np.float32(view.cells_y))
    )
    # The conversion of a number out of range is undefined: only what is inside is converted.
    row = np.int32(line if inside else _ZERO)
    index = row * np.int32(view.cells_x) + np.int32(column if inside else _ZERO)
    return index if inside else np.int32(-1)


@njit(cache=True, error_model="numpy")
def measure_row(
    z_above: Float32Array,
    z_row: Float32Array,
    z_below: Float32Array,
    baseline_px: int,
    ray_x: Float32Array,
    ray_y: np.float32,
    focal: FocalConstants,
    noise: NoiseConstants,
    view: ViewConstants,
    height_m: Float32Array,
    weight: Float32Array,
    cell: Int32Array,
) -> None:
    """Height above the camera, 1 / variance of that height and cell of every pixel of a row.

    h = e.p_T. The three z rows carry a margin of `baseline_px` zeros at both ends. cell = -1: no
    measurement.
    """
    half = np.float32(0.5) / np.float32(baseline_px)
    focal_slope_x = focal.x_px * half
    focal_slope_y = focal.y_px * half
    # Slices with the same index keep the compiler from seeing possible negative subscripts.
    width = ray_x.shape[0]
    left = z_row[:width]
    middle = z_row[baseline_px:][:width]
    right = z_row[baseline_px + baseline_px :][:width]
    above = z_above[baseline_px:][:width]
    below = z_below[baseline_px:][:width]
    for u in range(width):
        valid = middle[u] > _ZERO
        z = middle[u] if valid else _ONE
        x = ray_x[u]
        slope_x = _gradient(right[u], z, left[u], focal_slope_x)
        slope_y = _gradient(below[u], z, above[u], focal_slope_y)
        t = _angle_ratio(z, x, ray_y, slope_x, slope_y)
        rise = view.r20 * x + view.r21 * ray_y + view.r22
        ray2 = _ONE + x * x + ray_y * ray_y
        variance = _height_variance(z, t, rise, ray2, focal.inverse_sensor_px, noise)
        index = _cell_of(z, x, ray_y, view)
        height_m[u] = z * rise
        weight[u] = _ONE / max(variance, _MIN_VARIANCE_M2)
        cell[u] = index if valid else np.int32(-1)


@njit(cache=True, error_model="numpy")
def add_row(
    height_m: Float32Array, weight: Float32Array, cell: Int32Array, sums: Float64Array
) -> int:
    """Add a row's measurements to `sums` (cells, 4) from left to right; return how many."""
    added = 0
    for u in range(cell.shape[0]):
        i = cell[u]
        if i >= 0:
            w = np.float64(weight[u])
            h = np.float64(height_m[u])
            wh = w * h
            sums[i, 0] += w
            sums[i, 1] += wh
            sums[i, 2] += wh * h
            sums[i, 3] += 1.0
            added += 1
    return added


@njit(cache=True, error_model="numpy")
def accumulate(
    z_m: Float32Array,
    baseline_px: int,
    ray_x: Float32Array,
    ray_y: Float32Array,
    focal: FocalConstants,
    noise: NoiseConstants,
    view: ViewConstants,
    sums: Float64Array,
) -> int:
    """Measure and add every row of `z_m` (with its margin); return the measurements added."""
    width = ray_x.shape[0]
    height_m = np.empty(width, np.float32)
    weight = np.empty(width, np.float32)
    cell = np.empty(width, np.int32)
    added = 0
    for v in range(ray_y.shape[0]):
        measure_row(
            z_m[v],
            z_m[v + baseline_px],
            z_m[v + baseline_px + baseline_px],
            baseline_px,
            ray_x,
            ray_y[v],
            focal,
            noise,
            view,
            height_m,
            weight,
            cell,
        )
        added += add_row(height_m, weight, cell, sums)
    return added
