"""Plain scenes for tests: planes seen by a small camera, without noise unless it is asked for."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from acquisition.messages.frames import (
    DEPTH_OPTICAL_FRAME,
    MOCAP_BODY_FRAME,
    StaticTransform,
    StaticTransforms,
)
from drivers.samples import CameraIntrinsics, DepthFrame, PoseSample, frozen_array
from mapping.geometry import RigidTransform, UncertainPose
from mapping.measurement import View

Float64Array = NDArray[np.float64]

# A Kinect V1 decimated by 10: 57 x 43 degrees.
CAMERA = CameraIntrinsics(64, 48, 58.0, 58.0, 31.5, 23.5)
# Optical frame (x right, y down, z forward) to a body that looks along x with z up.
BODY_FROM_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
NO_COVARIANCE = np.zeros((6, 6))


def looking(yaw_deg: float = 0.0, pitch_deg: float = 25.0, roll_deg: float = 0.0) -> Float64Array:
    """Return the optical frame in T of a camera that looks `pitch_deg` down."""
    angles = [yaw_deg, pitch_deg, roll_deg]
    turn = Rotation.from_euler("ZYX", angles, degrees=True).as_matrix()
    rotation: Float64Array = turn @ BODY_FROM_OPTICAL
    return rotation


def rays(camera: CameraIntrinsics) -> Float64Array:
    """Return (height, width, 3) rays with z = 1 in the optical frame."""
    x = (np.arange(camera.width_px) - camera.cx_px) / camera.fx_px
    y = (np.arange(camera.height_px) - camera.cy_px) / camera.fy_px
    u, v = np.meshgrid(x, y)
    return np.stack([u, v, np.ones_like(u)], axis=-1)


def plane_z(
    camera: CameraIntrinsics, rotation: Float64Array, normal: ArrayLike, distance_m: float
) -> Float64Array:
    """Return the exact z of every pixel on the plane normal . p = distance_m; 0 = not hit.

    p is relative to the camera, in axes of T.
    """
    toward = rays(camera) @ (rotation.T @ np.asarray(normal, float))
    with np.errstate(divide="ignore"):
        z = distance_m / toward
    return np.where((z > 0.0) & (z < 60.0), z, 0.0)


def millimetres(z_m: Float64Array) -> NDArray[np.uint16]:
    """Return a read-only depth image, as a stream gives it."""
    depth_mm = np.rint(1000.0 * z_m).astype(np.uint16)
    depth_mm.flags.writeable = False
    return depth_mm


def floor_frame(
    t_ns: int,
    height_m: float = 0.4,
    rotation: Float64Array | None = None,
    camera: CameraIntrinsics = CAMERA,
) -> DepthFrame:
    """Return a flat floor, `height_m` below the camera."""
    rotation = looking() if rotation is None else rotation
    z_m = plane_z(camera, rotation, (0.0, 0.0, 1.0), -height_m)
    return DepthFrame(t_ns, millimetres(z_m), camera, 0)


def pose_sample(
    t_ns: int,
    position_m: ArrayLike = (0.0, 0.0, 0.4),
    rotation: Float64Array | None = None,
    covariance: ArrayLike = NO_COVARIANCE,
) -> PoseSample:
    """Return a pose of the tracked body."""
    rotation = looking() if rotation is None else rotation
    quat = Rotation.from_matrix(rotation).as_quat(scalar_first=True)
    return PoseSample(
        t_ns,
        frozen_array(position_m, (3,)),
        frozen_array(quat, (4,)),
        frozen_array(covariance, (6, 6)),
        0,
    )


def mount(
    position_m: ArrayLike = (0.0, 0.0, 0.0), quat_wxyz: ArrayLike = (1.0, 0.0, 0.0, 0.0)
) -> StaticTransforms:
    """Return where the camera sits on the tracked body; the default says it is that body."""
    transform = StaticTransform(
        MOCAP_BODY_FRAME,
        DEPTH_OPTICAL_FRAME,
        frozen_array(position_m, (3,)),
        frozen_array(quat_wxyz, (4,)),
    )
    return StaticTransforms(0, (transform,))


def view_of(
    rotation: Float64Array,
    position_m: ArrayLike = (0.0, 0.0, 0.0),
    lever_m: ArrayLike = (0.0, 0.0, 0.0),
    covariance: ArrayLike = NO_COVARIANCE,
    t_ns: int = 0,
) -> View:
    """Return a view from a camera that sits `lever_m`, in axes of T, away from the tracked body."""
    camera = np.asarray(position_m, float)
    body = RigidTransform(np.eye(3), camera - np.asarray(lever_m, float))
    pose = UncertainPose(t_ns, body, np.asarray(covariance, float))
    return View(pose, RigidTransform(rotation, camera))
