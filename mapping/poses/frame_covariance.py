"""The part of a pose's covariance that the measurements of its frame carry."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapping.motion.pose_errors import PoseErrorModel

Float64Array = NDArray[np.float64]


def frame_covariance(covariance: Float64Array, errors: PoseErrorModel) -> Float64Array:
    """Return the covariance (6, 6) that a frame's measurements carry for their pose.

    What is counted at read-out still weighs here: without it near readings, which are the best,
    would overrule all that was seen from afar, and a map that remembers nothing but the last frames
    lets aligned poses drift (23 mm instead of 3 on a smooth drive). Of poses whose motions count,
    only the tilt is left, which levelling finds anew.

    Args:
        covariance: (6, 6) of the pose.
        errors: where the errors of such poses are counted.
    """
    if errors.pose_covariance and not errors.motion_covariance:
        return covariance
    variances = [errors.frame_sigma_m**2, errors.frame_sigma_rad**2, errors.frame_sigma_rad**2]
    counted = np.diag([0.0, 0.0, *variances, 0.0])
    if errors.pose_covariance:
        counted[3:5, 3:5] = covariance[3:5, 3:5]
    return counted
