"""Roll, pitch and height of the depth camera on the rover, from a flat floor that both stand on.

The floor gives two angles and a distance; the heading of the camera and its place along the
floor are not observed and stay those of the recording's mount.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from acquisition.messages.frames import DEPTH_OPTICAL_FRAME
from calibration_rigs.errors import RigError
from calibration_rigs.mount_rig.floor import Floor, find_floor
from drivers.samples import DepthFrame
from mapping.geometry import RigidTransform
from mapping.noise import DepthNoiseModel

Float64Array = NDArray[np.float64]

# The block of rover.toml that is written.
TABLE = f"mounts.{DEPTH_OPTICAL_FRAME}"
MOUNT_KEYS = ("parent", "position_m", "quaternion_wxyz", "sigma_m", "sigma_deg")

_FEWEST_FRAMES = 10
# A camera that stands still sees the same floor; its noise moves the normal by far less.
_STILL_RAD = math.radians(0.3)


@dataclass(frozen=True, slots=True)
class CameraMount:
    """The camera's mount as the floor shows it.

    Attributes:
        parent: the frame that it is given in.
        T_parent_camera: the mount, its heading and horizontal place as they were.
        height_m: of the camera above the floor.
        roll_rad, pitch_rad: how far it is turned against the mount in the recording, about the
            parent's x and y.
        covariance: (3, 3) of roll, pitch, height: rad^2, rad m, m^2.
        frames: how many images.
        misfit: of the floor, in sigma of the noise model.
    """

    parent: str
    T_parent_camera: RigidTransform
    height_m: float
    roll_rad: float
    pitch_rad: float
    covariance: Float64Array
    frames: int
    misfit: float

    def as_json(self) -> object:
        """Return all numbers by name."""
        return {
            "parent": self.parent,
            "position_m": self.T_parent_camera.translation_m.tolist(),
            "quaternion_wxyz": _quat_wxyz(self.T_parent_camera).tolist(),
            "height_m": self.height_m,
            "roll_rad": self.roll_rad,
            "pitch_rad": self.pitch_rad,
            "covariance_roll_pitch_height": self.covariance.tolist(),
            "frames": self.frames,
            "misfit_sigma": self.misfit,
        }

    def describe(self) -> list[str]:
        """Return lines for people."""
        roll, pitch, height = np.sqrt(np.diag(self.covariance))
        turned = (
            f"turned against the mount in the recording by roll "
            f"{math.degrees(self.roll_rad):.3f} +- {math.degrees(roll):.3f} and pitch "
            f"{math.degrees(self.pitch_rad):.3f} +- {math.degrees(pitch):.3f} deg"
        )
        return [
            f"camera {self.height_m:.4f} +- {height:.4f} m above the floor, {self.frames} frames",
            turned,
            "not observed, as before: heading and horizontal place",
        ]

    def toml(self) -> str:
        """Return the block for rover.toml.

        One sigma for all axes, as rover.toml has it: the larger of roll's and pitch's.
        """
        sigma = np.sqrt(np.diag(self.covariance))
        position = ", ".join(f"{value:.5f}" for value in self.T_parent_camera.translation_m)
        quat = ", ".join(f"{value:.8f}" for value in _quat_wxyz(self.T_parent_camera))
        return (
            f"[{TABLE}]\n"
            f'parent = "{self.parent}"\n'
            f"position_m = [{position}]\n"
            f"quaternion_wxyz = [{quat}]\n"
            f"sigma_m = {sigma[2]:.5f}\n"
            f"sigma_deg = {math.degrees(max(sigma[:2])):.4f}\n"
        )


def calibrate_camera(
    frames: Iterable[DepthFrame],
    nominal: RigidTransform,
    parent: str,
    noise: DepthNoiseModel,
    parent_height_m: float | None = None,
) -> CameraMount:
    """Return the mount from images of a flat floor, rover and camera at rest on it.

    Args:
        frames: ten or more.
        nominal: T_parent_camera as it was thought to be.
        parent: the frame of `nominal`, its z axis at right angles to the floor.
        noise: of the camera.
        parent_height_m: of the parent's origin above the floor; with it the camera's z in the
            parent is measured, without it stays as it was.

    The covariance has two parts: the scatter of the images over their number, and one sigma of
    the camera's depth bias, which all images share.

    Raises:
        RigError: too few images, no floor in one of them, or something moved.
    """
    images = list(frames)
    if len(images) < _FEWEST_FRAMES:
        raise RigError(
            f"{len(images)} depth images; expected {_FEWEST_FRAMES} or more of a flat floor, rover "
            "and camera at rest"
        )
    floors = [find_floor(frame.depth_mm, frame.camera, noise) for frame in images]
    seen = np.array([_seen(floor, nominal) for floor in floors])
    _require_still(seen)
    biased = _seen(find_floor(images[0].depth_mm, images[0].camera, noise, 1.0), nominal) - seen[0]
    scatter = np.atleast_2d(np.cov(seen.T)) / len(images)
    roll, pitch, height_m = seen.mean(axis=0)
    # The small rotation that makes the floor level in the parent; the heading stays.
    turn = Rotation.from_rotvec([roll, pitch, 0.0]).as_matrix()
    position = nominal.translation_m.copy()
    if parent_height_m is not None:
        position[2] = height_m - parent_height_m
    return CameraMount(
        parent=parent,
        T_parent_camera=RigidTransform(turn @ nominal.rotation, position),
        height_m=float(height_m),
        roll_rad=float(roll),
        pitch_rad=float(pitch),
        covariance=scatter + np.outer(biased, biased),
        frames=len(images),
        misfit=float(np.median([floor.misfit for floor in floors])),
    )


def _seen(floor: Floor, nominal: RigidTransform) -> Float64Array:
    """Return roll, pitch (rad) of the turn that brings the floor's normal upright, and height."""
    up = nominal.rotation @ floor.up
    axis = np.cross(up, [0.0, 0.0, 1.0])
    sine = float(np.linalg.norm(axis))
    angle = math.atan2(sine, float(up[2]))
    turn = axis * (angle / sine if sine > 0.0 else 0.0)
    return np.array([turn[0], turn[1], floor.height_m])


def _require_still(seen: Sequence[Float64Array] | Float64Array) -> None:
    spread = np.ptp(np.asarray(seen), axis=0)
    if max(spread[0], spread[1]) > 2.0 * _STILL_RAD:
        raise RigError(
            f"the floor tilts by {math.degrees(max(spread[0], spread[1])):.2f} deg between images; "
            "expected rover and camera at rest: switch off what shakes them"
        )


def _quat_wxyz(pose: RigidTransform) -> Float64Array:
    x, y, z, w = Rotation.from_matrix(pose.rotation).as_quat(canonical=True)
    return np.array([w, x, y, z])
