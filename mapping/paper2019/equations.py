"""Equations 11-17 and 28-32 of the paper, as printed.

"Uncertainty-Based Vibration/Gyro Composite Planetary Terrain Mapping", 2019;
`mapping.paper2019.faults` says what is wrong with them. C_TR maps rover to terrain coordinates,
which the paper writes C(Phi_RT)^T. Arrays of cells (..., 3, 3) and (..., 3) are taken at once.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapping.geometry import skew

Float64Array = NDArray[np.float64]


def gain(map_m2: Float64Array, measured_m2: Float64Array) -> Float64Array:
    """Return K_k = s_h^2 (s_h^2 + s_hp^2)^-1 (eq. 11)."""
    return map_m2 / (map_m2 + measured_m2)


def fused_height_m(
    map_m: Float64Array, map_m2: Float64Array, measured_m: Float64Array, measured_m2: Float64Array
) -> Float64Array:
    """Return h + K_k (h_p - h) (eq. 12; eq. 14 is the same with K_k written out)."""
    return map_m + gain(map_m2, measured_m2) * (measured_m - map_m)


def fused_variance_m2(map_m2: Float64Array, measured_m2: Float64Array) -> Float64Array:
    """Return s_hp^2 / (s_h^2 + s_hp^2) s_h^2 (eq. 15, which is eq. 13 with eq. 11)."""
    return measured_m2 / (map_m2 + measured_m2) * map_m2


def new_covariance_m2(height_m2: Float64Array, cell_size_m: float) -> Float64Array:
    """Return diag((d/2)^2, (d/2)^2, s_h^2) of cells just measured (eqs. 16, 17)."""
    covariance = np.zeros((*height_m2.shape, 3, 3))
    covariance[..., 0, 0] = covariance[..., 1, 1] = (cell_size_m / 2.0) ** 2
    covariance[..., 2, 2] = height_m2
    return covariance


def translation_jacobian(c_tr: Float64Array) -> Float64Array:
    """Return J_r = -C(Phi_R(k+1)T(k+1))^T (eq. 31); (3, 3)."""
    return -c_tr


def rotation_jacobian(c_tr: Float64Array, rover_to_point_m: Float64Array) -> Float64Array:
    """Return J_Phi = -C(Phi_RkTk)^T (r_RP)^x with r_RP in terrain coordinates (eq. 32); (3, 3).

    The matrix expects rover coordinates: this is the printed fault.
    """
    return -c_tr @ skew(rover_to_point_m)


def moved_covariance_m2(
    covariance_m2: Float64Array,
    c_tr: Float64Array,
    rover_to_point_m: Float64Array,
    step_m2: Float64Array,
    yaw_rad2: float,
) -> Float64Array:
    """Return J_P S J_P' + J_r S_r J_r' + J_Phi S_Phi J_Phi' of cells (eq. 28), J_P = I (eq. 30).

    Args:
        covariance_m2: (..., 3, 3) of the cells before the step.
        c_tr: (3, 3) rover to terrain coordinates.
        rover_to_point_m: (..., 3) from the rover to the cells, terrain coordinates.
        step_m2: (3, 3) covariance of the rover's translation, rover coordinates (eq. 33).
        yaw_rad2: variance of its turn; S_Phi = diag(0, 0, yaw_rad2) by eq. 35 (eq. 34).
    """
    j_r = translation_jacobian(c_tr)
    # S_Phi has one entry, so that only the last column of J_Phi counts: -C (r x e).
    x, y = rover_to_point_m[..., 0], rover_to_point_m[..., 1]
    column = -np.stack([y, -x, np.zeros_like(x)], axis=-1) @ c_tr.T
    turned = yaw_rad2 * column[..., :, np.newaxis] * column[..., np.newaxis, :]
    return covariance_m2 + j_r @ step_m2 @ j_r.T + turned
