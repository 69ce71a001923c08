"""Roll, pitch and yaw, and how their errors relate to a small rotation about T's axes.

C_TR = Rz(yaw) Ry(pitch) Rx(roll), x forward, y left, z up: a positive pitch points the nose down.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from mapping.geometry import Float64Array, RigidTransform, UncertainPose


def rotation(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Float64Array:
    """Return C_TR (3, 3)."""
    matrix = Rotation.from_euler("ZYX", [yaw_rad, pitch_rad, roll_rad]).as_matrix()
    return np.asarray(matrix, np.float64)


def angles(c_tr: Float64Array) -> tuple[float, float, float]:
    """Return (roll, pitch, yaw) of C_TR; pitch within +-90 degrees."""
    roll = math.atan2(c_tr[2, 1], c_tr[2, 2])
    pitch = math.asin(min(1.0, max(-1.0, -c_tr[2, 0])))
    return roll, pitch, math.atan2(c_tr[1, 0], c_tr[0, 0])


def rotation_jacobian(pitch_rad: float, yaw_rad: float) -> Float64Array:
    """Return (3, 3): small changes of (roll, pitch, yaw) to a small rotation about T's axes.

    d = e_z dyaw + Rz e_y dpitch + Rz Ry e_x droll. Its inverse has the last row
    (cos yaw tan pitch, sin yaw tan pitch, 1).
    """
    sy, cy = math.sin(yaw_rad), math.cos(yaw_rad)
    sp, cp = math.sin(pitch_rad), math.cos(pitch_rad)
    return np.array([[cy * cp, -sy, 0.0], [sy * cp, cy, 0.0], [-sp, 0.0, 1.0]])


def to_pose(t_ns: int, vector: Float64Array, covariance: Float64Array) -> UncertainPose:
    """Return the pose of (6,) x, y, z, roll, pitch, yaw with their (6, 6) covariance."""
    roll, pitch, yaw = (float(value) for value in vector[3:])
    jacobian = np.eye(6)
    jacobian[3:, 3:] = rotation_jacobian(pitch, yaw)
    transform = RigidTransform(rotation(roll, pitch, yaw), np.array(vector[:3]))
    return UncertainPose(t_ns, transform, jacobian @ covariance @ jacobian.T)


def from_pose(
    transform: RigidTransform, covariance: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Return (6,) x, y, z, roll, pitch, yaw and their (6, 6) covariance: undoes `to_pose`."""
    roll, pitch, yaw = angles(transform.rotation)
    inverse = np.eye(6)
    inverse[3:, 3:] = np.linalg.inv(rotation_jacobian(pitch, yaw))
    vector = np.array([*transform.translation_m, roll, pitch, yaw])
    return vector, inverse @ covariance @ inverse.T
