"""A prior pose and what the map says of it, as one pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mapping.alignment.observability import metres_per_unit
from mapping.alignment.scan_to_map import Alignment
from mapping.alignment.settings import AlignmentSettings
from mapping.geometry import RigidTransform, UncertainPose

Float64Array = NDArray[np.float64]


def pose_difference(pose: RigidTransform, reference: RigidTransform) -> Float64Array:
    """Return (6,): shift and rotation vector about T's axes that lead from reference to pose."""
    turn = Rotation.from_matrix(pose.rotation @ reference.rotation.T)
    return np.concatenate([pose.translation_m - reference.translation_m, turn.as_rotvec()])


def moved(pose: RigidTransform, difference: Float64Array) -> RigidTransform:
    """Return a pose moved by (6,) shift and rotation vector about T's axes."""
    turn = Rotation.from_rotvec(difference[3:]).as_matrix()
    return RigidTransform(turn @ pose.rotation, pose.translation_m + difference[:3])


def fuse_pose(
    prior: UncertainPose,
    alignment: Alignment,
    settings: AlignmentSettings,
    *,
    hears_map: bool = False,
) -> UncertainPose:
    """Return the Kalman update of the prior, moved along the fixed directions only.

    K = D P (P + R)^-1, with D the projection on the directions: a prior without variance stays as
    it is, and so does every direction that the points do not fix, whatever the prior correlates.
    A prior that is further off than it claims (NIS per degree of freedom above 1) counts as that
    much less certain: it is the one of the two that can be wrong by a degree. One that has heard
    earlier alignments (`hears_map`) is given `prior_sigma_m` and `prior_sigma_rad` as well.
    """
    unit = metres_per_unit(settings)
    projection = alignment.directions @ alignment.directions.T * np.outer(1.0 / unit, unit)
    difference = pose_difference(alignment.pose.transform, prior.transform)
    p, r = prior.covariance, alignment.pose.covariance
    if hears_map:
        own = [settings.prior_sigma_m**2] * 3 + [settings.prior_sigma_rad**2] * 3
        p = p + projection @ np.diag(own) @ projection.T
    nis = float(difference @ np.linalg.solve(p + r, difference))
    p = p * max(nis / alignment.directions.shape[1], 1.0)
    gain = projection @ np.linalg.solve(p + r, p).T
    rest = np.eye(6) - gain
    covariance = rest @ p @ rest.T + gain @ r @ gain.T
    return replace(
        prior, transform=moved(prior.transform, gain @ difference), covariance=covariance
    )
