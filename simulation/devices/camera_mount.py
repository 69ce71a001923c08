"""Where the camera sits on the vehicle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Float64Array = NDArray[np.float64]

# Optical frame (x right, y down, z forward) to a body looking along x with z up.
BODY_FROM_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True, slots=True)
class CameraMount:
    """Pose of the camera's optical frame in the tracked body.

    Attributes:
        position_m: (3,) of the camera in the body.
        rotation: (3, 3) optical axes to body axes.
    """

    position_m: Float64Array
    rotation: Float64Array

    def camera_pose(
        self, position_m: Float64Array, rotation: Float64Array
    ) -> tuple[Float64Array, Float64Array]:
        """Return the camera's position and rotation in the world for those of the body."""
        return position_m + rotation @ self.position_m, rotation @ self.rotation


def on_rover() -> CameraMount:
    """Return a mount on a Jackal-sized rover: 16 cm ahead, 40 cm up, 25 degrees down."""
    down = Rotation.from_euler("y", 25.0, degrees=True).as_matrix()
    return CameraMount(np.array([0.16, 0.0, 0.40]), down @ BODY_FROM_OPTICAL)
