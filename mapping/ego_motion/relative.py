"""How much the pose's error has changed between two times.

The filter's states are not independent: most of an error at one time is still there a moment
later. With PHI, the derivative of the later error by the earlier one (`filter_kernels`),

    cov(e1, e0) = PHI P0,   cov(e1 - G e0) = P1 - PHI P0 G' - G P0 PHI' + G P0 G'

for any G: exactly what a filter with a clone of the earlier state (at a keyframe) would say, for
every pair of times, and positive semi-definite but for rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapping.geometry import Float64Array, RigidTransform, skew


@dataclass(frozen=True, slots=True)
class RelativeMotion:
    """Motion of base_link between two times, and its covariance.

    Attributes:
        t0_ns, t1_ns: the times.
        transform: T_R0R1, pose of the later base_link in the earlier one.
        covariance: (6, 6) of what the motion itself adds, in T's axes at the later place: of
            (x, y, z, rotation about T's x, y, z), in m^2, m rad and rad^2. It is cov(e1 - G e0),
            with e the errors of the two poses in the same order, and G that of a rigid body,
            G = [[1, -[dr]x], [0, 1]], dr the way from the earlier to the later place in T. An
            error e0 alone therefore leaves it 0: it moves the map and the rover together.
        joint: (12, 12) covariance of (e0, e1).
        clipped: eigenvalues of `covariance` that rounding had made negative.
    """

    t0_ns: int
    t1_ns: int
    transform: RigidTransform
    covariance: Float64Array
    joint: Float64Array
    clipped: int

    @property
    def covariance_xyz_yaw(self) -> Float64Array:
        """Return the (4, 4) part of `covariance` of (x, y, z, rotation about T's z)."""
        kept = [0, 1, 2, 5]
        return self.covariance[np.ix_(kept, kept)]


def relative_motion(
    times_ns: tuple[int, int],
    earlier: RigidTransform,
    later: RigidTransform,
    joint: Float64Array,
) -> RelativeMotion:
    """Return the motion between two poses.

    Args:
        times_ns: of both.
        earlier, later: T_TR of both.
        joint: (12, 12) covariance of both errors, T's axes.
    """
    carried = np.eye(6)
    carried[:3, 3:] = -skew(later.translation_m - earlier.translation_m)
    difference = np.hstack([-carried, np.eye(6)])
    covariance, clipped = positive(difference @ joint @ difference.T)
    transform = earlier.inverse() @ later
    return RelativeMotion(*times_ns, transform, covariance, joint, clipped)


def positive(matrix: Float64Array) -> tuple[Float64Array, int]:
    """Return a symmetric matrix without negative eigenvalues, and how many there were.

    Eigenvalues that are zero but for rounding are not counted.
    """
    symmetric = 0.5 * (matrix + matrix.T)
    values, vectors = np.linalg.eigh(symmetric)
    if values[0] >= 0.0:
        return symmetric, 0
    rounding = 1e-9 * max(values[-1], 0.0) + 1e-18
    clipped = int(np.count_nonzero(values < -rounding))
    return (vectors * np.maximum(values, 0.0)) @ vectors.T, clipped
