"""A floor with boxes on it or above it, seen by a Kinect-like camera with Nguyen's noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from drivers.samples import CameraIntrinsics, DepthFrame
from mapping.mapper import Mapper
from simulation.devices.ideal_camera import noisy_depth_mm
from simulation.devices.kinect import kinect_320
from tests.mapping.scenes import NO_COVARIANCE, looking, pose_sample, rays

Float64Array = NDArray[np.float64]
# (x_min, y_min, z_min, x_max, y_max, z_max) in T, metres.
Box = tuple[float, float, float, float, float, float]

KINECT = kinect_320()
_FARTHEST_M = 8.0


@lru_cache(maxsize=8)
def _look(
    camera: CameraIntrinsics,
    yaw_deg: float,
    pitch_deg: float,
    position_m: tuple[float, float, float],
    boxes: tuple[Box, ...],
) -> tuple[Float64Array, Float64Array]:
    """Return z (0 = nothing within 8 m) and the angle of incidence, an image each."""
    rotation = looking(yaw_deg, pitch_deg)
    ray = rays(camera)
    direction = ray @ rotation.T
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.where(direction[..., 2] < 0.0, -position_m[2] / direction[..., 2], np.inf)
        facing = np.abs(direction[..., 2])
        for box in boxes:
            low, high = np.subtract(box[:3], position_m), np.subtract(box[3:], position_m)
            a, b = low / direction, high / direction
            enter, leave = np.minimum(a, b), np.maximum(a, b)
            axis = enter.argmax(axis=-1)
            first, last = enter.max(axis=-1), leave.min(axis=-1)
            hit = (first <= last) & (first > 0.0) & (first < z)
            z = np.where(hit, first, z)
            side = np.take_along_axis(np.abs(direction), axis[..., None], axis=-1)[..., 0]
            facing = np.where(hit, side, facing)
    seen = z < _FARTHEST_M
    cosine = np.where(seen, facing / np.linalg.norm(ray, axis=-1), 1.0)
    return np.where(seen, z, 0.0), np.arccos(np.clip(cosine, 0.0, 1.0))


@dataclass
class PoseNoise:
    """Error of the poses that a mapper is told, and told of: Gauss-Markov, alike for 0.3 s."""

    sigma_m: float = 0.0
    sigma_rad: float = 0.0
    tau_s: float = 0.3
    now: Float64Array = field(default_factory=lambda: np.zeros(6))

    @property
    def sigmas(self) -> Float64Array:
        return np.repeat([self.sigma_m, self.sigma_rad], 3)

    def step(self, dt_s: float, random: np.random.Generator) -> Float64Array:
        """Return the error of (x, y, z, rotation about T's x, y, z)."""
        kept = np.exp(-dt_s / self.tau_s)
        fresh = self.sigmas * random.standard_normal(6)
        self.now = kept * self.now + np.sqrt(1.0 - kept**2) * fresh
        return self.now


class Stage:
    """A mapper and the camera in front of it, frame by frame."""

    def __init__(
        self,
        mapper: Mapper,
        seed: int = 1,
        camera: CameraIntrinsics = KINECT,
        rate_hz: int = 10,
        noise: PoseNoise | None = None,
    ) -> None:
        self.mapper = mapper
        self.frames = 0
        self._camera = camera
        self._rate_hz = rate_hz
        self._noise = noise
        self._random = np.random.default_rng(seed)

    def see(
        self,
        boxes: Sequence[Box],
        position_m: tuple[float, float, float] = (0.0, 0.0, 0.5),
        yaw_deg: float = 0.0,
        pitch_deg: float = 20.0,
    ) -> None:
        """Map one frame from there."""
        rotation = looking(yaw_deg, pitch_deg)
        t_ns = self.frames * (1_000_000_000 // self._rate_hz)
        z_m, angle = _look(self._camera, yaw_deg, pitch_deg, position_m, tuple(boxes))
        depth_mm = noisy_depth_mm(z_m, angle, self._random)
        depth_mm.flags.writeable = False
        told_m: ArrayLike = position_m
        covariance = NO_COVARIANCE
        if self._noise is not None:
            error = self._noise.step(1.0 / self._rate_hz, self._random)
            told_m = position_m + error[:3]
            rotation = Rotation.from_rotvec(error[3:]).as_matrix() @ rotation
            covariance = np.diag(self._noise.sigmas**2)
        self.mapper.add(pose_sample(t_ns, told_m, rotation, covariance))
        self.mapper.add(DepthFrame(t_ns, depth_mm, self._camera, self.frames))
        self.frames += 1

    def heights(self, box: Box) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Return heights and states of the cells whose centres lie under a box."""
        map_ = self.mapper.elevation_map()
        x = (map_.x_m > box[0]) & (map_.x_m < box[3])
        y = (map_.y_m > box[1]) & (map_.y_m < box[4])
        place = np.ix_(y, x)
        return map_.elevation_m[place], map_.state[place]
