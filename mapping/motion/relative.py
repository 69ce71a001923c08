"""The uncertainty of a motion from one pose to the next (paper eqs. 28 and 48-54, corrected).

R~ is the body turned upright: x, y, z and yaw. C = C_TR~, e = e_z, dr = displacement in T.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from operator import mul
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapping.geometry import RigidTransform, UncertainPose

Float64Array = NDArray[np.float64]

# Rounding leaves eigenvalues this small a share of the largest one below 0.
_ROUNDING = 1e-12


@dataclass(frozen=True, slots=True)
class RelativeMotion:
    """A motion of the rover, and how wrong it may be.

    Attributes:
        t_ns: time of its end.
        position_m: (3,) the rover in T at its end.
        yaw_rad: heading of the axes that `covariance` is given in: the rover's before the motion,
            or 0 for a covariance in axes of T.
        covariance: (4, 4) of the error of (x, y, z, yaw) of this motion: m^2, m rad, rad^2; zeros
            where the source does not tell.
        distance_m: way driven; 0 at rest, however much the poses jitter.
    """

    t_ns: int
    position_m: Float64Array
    yaw_rad: float
    covariance: Float64Array
    distance_m: float


class Clipped(NamedTuple):
    """A covariance without negative eigenvalues, and whether it had any."""

    covariance: Float64Array
    was_clipped: bool


def relative_covariance(
    before: Float64Array, after: Float64Array, displacement_m: Float64Array, yaw_rad: float
) -> Clipped:
    """Return the covariance of a motion from the covariances of the poses at its ends.

    Sigma_rel = G^-1 (Sigma_k+1 - F Sigma_k F') G^-T with F = [I, [e]x dr; 0, 1], G = [C, 0; 0, 1].

    Args:
        before, after: (4, 4) covariances of (x, y, z, yaw) in T; see `upright_covariance`.
        displacement_m: (3,) dr.
        yaw_rad: heading before the motion.

    Returns:
        (4, 4) of (x, y, z, yaw) in R~ before the motion, PSD: a filter that has learned something
        on the way makes the difference negative in some direction, which is then clipped to 0.
    """
    forward = np.eye(4)
    forward[:2, 3] = -displacement_m[1], displacement_m[0]
    to_body = to_terrain_axes(yaw_rad).T
    return clip_to_psd(to_body @ (after - forward @ before @ forward.T) @ to_body.T)


def clip_to_psd(matrix: Float64Array) -> Clipped:
    """Return a symmetric matrix with its negative eigenvalues set to 0."""
    symmetric = 0.5 * (matrix + matrix.T)
    if _has_root(symmetric.tolist()):
        return Clipped(symmetric, was_clipped=False)
    values, vectors = np.linalg.eigh(symmetric)
    if values[0] >= -_ROUNDING * abs(values[-1]):
        return Clipped(symmetric, was_clipped=False)
    return Clipped((vectors * np.maximum(values, 0.0)) @ vectors.T, was_clipped=True)


def _has_root(rows: list[list[float]]) -> bool:
    """Tell whether Cholesky's algorithm comes through: so for positive definite matrices alone.

    In plain Python: of so few numbers that takes a fraction of the time of a call into LAPACK.
    """
    root: list[list[float]] = []
    for i, row in enumerate(rows):
        line: list[float] = []
        for j, above in enumerate(root):
            line.append((row[j] - sum(map(mul, line, above))) / above[j])
        pivot = row[i] - sum(map(mul, line, line))
        if not pivot > 0.0:
            return False
        line.append(math.sqrt(pivot))
        root.append(line)
    return True


def yaw_of(transform: RigidTransform) -> float:
    """Return the heading of the body's x axis in T."""
    return math.atan2(transform.rotation[1, 0], transform.rotation[0, 0])


def upright_covariance(pose: UncertainPose) -> Float64Array:
    """Return the (4, 4) covariance of (x, y, z, yaw) of a pose with a full rotation error.

    d yaw = [cos(psi) tan(theta), sin(psi) tan(theta), 1] . (rotation about T's x, y, z), theta =
    pitch, z - y - x convention: not the rotation's z alone.
    """
    rotation = pose.transform.rotation
    level = math.hypot(rotation[0, 0], rotation[1, 0])
    jacobian = np.zeros((4, 6))
    jacobian[:3, :3] = np.eye(3)
    # cos(psi) tan(theta) with cos(psi) = r00 / level and tan(theta) = -r20 / level.
    jacobian[3, 3:5] = -rotation[2, 0] * rotation[:2, 0] / level**2
    jacobian[3, 5] = 1.0
    reduced: Float64Array = jacobian @ pose.covariance @ jacobian.T
    return reduced


def to_terrain_axes(yaw_rad: float) -> Float64Array:
    """Return G (4, 4): errors of (x, y, z, yaw) in R~ to those in axes of T."""
    cosine, sine = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array(
        [
            [cosine, -sine, 0.0, 0.0],
            [sine, cosine, 0.0, 0.0],
            [0.0, 0.0, 1.0, 0.0],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
