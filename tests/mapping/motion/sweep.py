"""What one motion does to one cell, straight from paper eq. 28 in its corrected form."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mapping.motion.relative import RelativeMotion

Float64Array = NDArray[np.float64]


def growth(motion: RelativeMotion, cell_m: Float64Array) -> Float64Array:
    """Return (3, 3) that the motion adds to the covariance of a cell at `cell_m` (3,) in T."""
    lever = cell_m - motion.position_m
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("z", motion.yaw_rad).as_matrix()
    jacobian = np.hstack([np.eye(3), np.cross([0.0, 0.0, 1.0], lever)[:, np.newaxis]])
    added: Float64Array = jacobian @ turn @ motion.covariance @ turn.T @ jacobian.T
    return added
