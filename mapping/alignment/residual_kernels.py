"""Distances of points from planes, and their normal equations (numba, cached, fixed order)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.alignment.plane_kernels import (
    PLANE_HEIGHT,
    PLANE_SLOPE_VARIANCE,
    PLANE_SLOPE_X,
    PLANE_SLOPE_Y,
    PLANE_VARIANCE,
)
from mapping.alignment.point_kernels import POINT_DEPTH, POINT_X, POINT_Y, POINT_Z

Float64Array = NDArray[np.float64]


class Guess(NamedTuple):
    """The pose that is tried, relative to the prior's body and in T's axes.

    A point q of the frame is tried at R q + shift. rXY: elements of R. lever_*: the camera, turned
    by R. corner_*: corner of the window of cells. base_z_m: height of the prior's body in T.
    """

    r00: float
    r01: float
    r02: float
    r10: float
    r11: float
    r12: float
    r20: float
    r21: float
    r22: float
    shift_x_m: float
    shift_y_m: float
    shift_z_m: float
    lever_x_m: float
    lever_y_m: float
    lever_z_m: float
    corner_x_m: float
    corner_y_m: float
    base_z_m: float
    cell_size_m: float
    cells_x: int
    cells_y: int


class Weighting(NamedTuple):
    """cut_m: residuals beyond are left out. scale: a residual of so many sigma weighs half.

    floor_m2: added to every variance, so that weights stay finite.
    """

    cut_m: float
    scale: float
    floor_m2: float


class _Meeting(NamedTuple):
    """A point q (turned by R) above a plane with unit normal n: distance and its variance.

    slope_variance: variance of n along x and along y, from the noise of the plane's slopes.
    """

    met: bool
    qx: float
    qy: float
    qz: float
    nx: float
    ny: float
    nz: float
    distance_m: float
    variance_m2: float
    slope_variance: float


@njit(inline="always")
def _meet(
    point: Float64Array, axial_m2: float, planes: Float64Array, g: Guess, w: Weighting
) -> _Meeting:
    """Hold a point against the plane of the cell under it."""
    x, y, z = point[POINT_X], point[POINT_Y], point[POINT_Z]
    qx = g.r00 * x + g.r01 * y + g.r02 * z
    qy = g.r10 * x + g.r11 * y + g.r12 * z
    qz = g.r20 * x + g.r21 * y + g.r22 * z
    px = qx + g.shift_x_m - g.corner_x_m
    py = qy + g.shift_y_m - g.corner_y_m
    column = np.floor(px / g.cell_size_m)
    row = np.floor(py / g.cell_size_m)
    if not (0.0 <= column < g.cells_x and 0.0 <= row < g.cells_y):
        return _Meeting(False, qx, qy, qz, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0)
    plane = planes[np.int64(row) * g.cells_x + np.int64(column)]
    slope_x, slope_y = plane[PLANE_SLOPE_X], plane[PLANE_SLOPE_Y]
    nz = 1.0 / np.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    nx, ny = -slope_x * nz, -slope_y * nz
    ground = plane[PLANE_HEIGHT] + slope_x * (px - (column + 0.5) * g.cell_size_m)
    ground += slope_y * (py - (row + 0.5) * g.cell_size_m)
    distance = nz * (qz + g.shift_z_m + g.base_z_m - ground)
    ray = nx * (qx - g.lever_x_m) + ny * (qy - g.lever_y_m) + nz * (qz - g.lever_z_m)
    ray /= point[POINT_DEPTH]
    variance = axial_m2 * ray * ray + plane[PLANE_VARIANCE] * nz * nz + w.floor_m2
    met = plane[PLANE_VARIANCE] >= 0.0 and abs(distance) <= w.cut_m
    noise = plane[PLANE_SLOPE_VARIANCE] * nz * nz
    return _Meeting(met, qx, qy, qz, nx, ny, nz, distance, variance, noise)


@njit(inline="always")
def _add(m: _Meeting, weight: float, sums: Float64Array) -> None:
    """Add w J'J, w J'_noise J_noise and w J r to sums[0:6], sums[6:12] and sums[12], (13, 6).

    J = (n, q x n). A slope that is off turns n within the horizontal plane: J_noise is J with n
    along x, and along y.
    """
    jacobian = (
        m.nx,
        m.ny,
        m.nz,
        m.qy * m.nz - m.qz * m.ny,
        m.qz * m.nx - m.qx * m.nz,
        m.qx * m.ny - m.qy * m.nx,
    )
    along_x = (1.0, 0.0, 0.0, 0.0, m.qz, -m.qy)
    along_y = (0.0, 1.0, 0.0, -m.qz, 0.0, m.qx)
    noise = weight * m.slope_variance
    for a in range(6):
        for b in range(a + 1):
            sums[a, b] += weight * jacobian[a] * jacobian[b]
            sums[6 + a, b] += noise * (along_x[a] * along_x[b] + along_y[a] * along_y[b])
        sums[12, a] += weight * jacobian[a] * m.distance_m


@njit(cache=True, error_model="numpy")
def normal_equations(
    points: Float64Array,
    axial_m2: Float64Array,
    planes: Float64Array,
    guess: Guess,
    weighting: Weighting,
    sums: Float64Array,
    residuals: Float64Array,
) -> int:
    """Sum the normal equations over all points; return how many of them met a plane.

    r = n . (p - p0) with the plane's unit normal n; J = dr/d(shift, rotation) = (n, q x n);
    weight = Cauchy's 1 / (1 + (r / (scale sigma))^2) over the variance sigma^2 of r: that of the
    depth along the ray, and the spread of the map around the plane.

    Args:
        points: (N, point columns).
        axial_m2: (N,) variances along the optical axis.
        planes: (cells, plane columns).
        guess: the pose that is tried.
        weighting: of the residuals.
        sums: (13, 6) is overwritten: rows 0-5 the normal matrix, 6-11 what noise of the planes'
            slopes adds to it, 12 the gradient; of both matrices the lower triangle.
        residuals: (N,), filled from the front with |r| / sigma of the points that met a plane.
    """
    sums[:] = 0.0
    met = 0
    for i in range(points.shape[0]):
        m = _meet(points[i], axial_m2[i], planes, guess, weighting)
        if m.met:
            ratio2 = m.distance_m * m.distance_m / m.variance_m2
            residuals[met] = np.sqrt(ratio2)
            met += 1
            scaled = ratio2 / (weighting.scale * weighting.scale)
            _add(m, 1.0 / (m.variance_m2 * (1.0 + scaled)), sums)
    return met
