"""Rotations, rigid transforms and poses between two stamps.

`C_AB` maps B-coordinates to A-coordinates; `T_AB` is that rotation with the position of B's
origin in A. Frames: T terrain (z up, fixed), B tracked body, R rover, S depth sensor (optical:
x right, y down, z forward). SI units, radians, float64.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mapping.errors import MappingError

Float64Array = NDArray[np.float64]

# A world has its origin nearer than this (a UTM northing ends at 1e7 m).
_FARTHEST_M = 1e8
# A quaternion written with four decimals is off by up to 1e-4.
_UNIT_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True)
class RigidTransform:
    """Transform of B-coordinates to A-coordinates: p_A = rotation p_B + translation_m.

    Attributes:
        rotation: (3, 3) C_AB.
        translation_m: (3,) origin of B in A.
    """

    rotation: Float64Array
    translation_m: Float64Array

    @classmethod
    def identity(cls) -> RigidTransform:
        """Return the transform that changes nothing."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_quat_wxyz(cls, position_m: Float64Array, quat_wxyz: Float64Array) -> RigidTransform:
        """Build from a position (3,) and a unit quaternion (4,), w first.

        Raises:
            MappingError: not finite, absurdly far away, or the quaternion is no rotation.
        """
        if not np.all(np.abs(position_m) <= _FARTHEST_M):
            raise MappingError(
                f"position is {_text(position_m)} m; expected numbers up to {_FARTHEST_M:g}"
            )
        norm = math.hypot(*quat_wxyz)
        if not abs(norm - 1.0) <= _UNIT_TOLERANCE:
            raise MappingError(
                f"quaternion wxyz {_text(quat_wxyz)} has length {norm:.4g}; expected 1"
            )
        rotation = Rotation.from_quat(quat_wxyz, scalar_first=True).as_matrix()
        return cls(rotation, np.asarray(position_m, dtype=np.float64))

    def __matmul__(self, other: RigidTransform) -> RigidTransform:
        """Return T_AC for self = T_AB and other = T_BC."""
        return RigidTransform(
            self.rotation @ other.rotation, self.rotation @ other.translation_m + self.translation_m
        )

    def inverse(self) -> RigidTransform:
        """Return T_BA."""
        return RigidTransform(self.rotation.T, -self.rotation.T @ self.translation_m)

    def apply(self, points_m: Float64Array) -> Float64Array:
        """Map points (..., 3) from B to A."""
        return points_m @ self.rotation.T + self.translation_m


def _text(values: Float64Array) -> str:
    return "(" + ", ".join(f"{value:g}" for value in values) + ")"


def skew(v: Float64Array) -> Float64Array:
    """Return the (3, 3) matrix [v]x with [v]x w = v x w."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


@dataclass(frozen=True, slots=True)
class UncertainPose:
    """Pose of the tracked body in T with its covariance.

    Attributes:
        t_ns: time of the pose.
        transform: T_TB.
        covariance: (6, 6) of (x, y, z, rotation about T's x, y, z): m^2, m rad, rad^2.
    """

    t_ns: int
    transform: RigidTransform
    covariance: Float64Array


def interpolate_pose(before: UncertainPose, after: UncertainPose, t_ns: int) -> UncertainPose:
    """Return the pose at `t_ns`, between two poses.

    Position and covariance are linear in time, the rotation turns at constant rate. At the stamp
    of either pose that very pose is returned, bit for bit. The covariance of the two ends is not
    averaged down: their errors are taken as one common error.
    """
    if t_ns == before.t_ns:
        return before
    if t_ns == after.t_ns:
        return after
    share = (t_ns - before.t_ns) / (after.t_ns - before.t_ns)
    turn = Rotation.from_matrix(before.transform.rotation.T @ after.transform.rotation)
    rotation = (
        before.transform.rotation @ Rotation.from_rotvec(share * turn.as_rotvec()).as_matrix()
    )
    position = (1 - share) * before.transform.translation_m + share * after.transform.translation_m
    covariance = (1 - share) * before.covariance + share * after.covariance
    return UncertainPose(t_ns, RigidTransform(rotation, position), covariance)
