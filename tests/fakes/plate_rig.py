"""A plate in front of a simulated Kinect: frames, tape readings, and what is true of them.

The plate is flat unless it is asked to bend, stands in empty space or before a wall, and its
tape is exact but for a spread of 1 mm. Not faked: lens distortion, reflections, warming up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import cos, radians, sin

import numpy as np
from numpy.typing import NDArray

from drivers.errors import EndOfSource
from drivers.faults import NO_FAULTS, Faults
from drivers.samples import CameraIntrinsics, DepthFrame, Sample
from drivers.source import SourceInfo
from simulation.devices.kinect import CleanView, KinectModel, kinect_640, kinect_depth_mm

Float64Array = NDArray[np.float64]

STATIONS_M = tuple(round(1.0 + 0.2 * k, 1) for k in range(11))
ANGLES_DEG = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0)


@dataclass(frozen=True)
class Plate:
    """Where the plate stands: its middle in the optical frame, and how it is turned."""

    z_m: float
    angle_deg: float = 0.0
    x_m: float = 0.0
    y_m: float = 0.0
    tip_deg: float = 0.0
    width_m: float = 1.0
    height_m: float = 1.0
    bend_m: float = 0.0
    wall_m: float = 0.0

    def axes(self) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Return the unit vectors along the plate, down the plate, and its normal."""
        turn, tip = radians(self.angle_deg), radians(self.tip_deg)
        along = np.array([cos(turn), 0.0, -sin(turn)])
        normal = np.array([sin(turn) * cos(tip), sin(tip), cos(turn) * cos(tip)])
        return along, np.cross(normal, along), normal

    def corners_m(self, random: np.random.Generator) -> tuple[float, float, float]:
        """Return the tape to the top left, top right and bottom left corner."""
        along, down, _ = self.axes()
        half_along, half_down = 0.5 * self.width_m * along[2], 0.5 * self.height_m * down[2]
        exact = [
            self.z_m - half_along - half_down,
            self.z_m + half_along - half_down,
            self.z_m - half_along + half_down,
        ]
        top_left, top_right, bottom_left = (
            round(float(z + 0.001 * random.standard_normal()), 3) for z in exact
        )
        return top_left, top_right, bottom_left

    def view(self, camera: CameraIntrinsics) -> CleanView:
        """Return what a perfect camera sees of it."""
        x = (np.arange(camera.width_px) - camera.cx_px) / camera.fx_px
        y = (np.arange(camera.height_px) - camera.cy_px) / camera.fy_px
        rays = np.stack([*np.meshgrid(x, y), np.ones((y.size, x.size))], axis=-1)
        along, down, normal = self.axes()
        middle = np.array([self.x_m, self.y_m, self.z_m])
        toward = rays @ normal
        z = np.divide(normal @ middle, toward, out=np.zeros_like(toward), where=toward > 1e-6)
        points = rays * z[..., np.newaxis] - middle
        s, t = points @ along, points @ down
        on = (z > 0.0) & (abs(s) <= 0.5 * self.width_m) & (abs(t) <= 0.5 * self.height_m)
        bent = z + self.bend_m * (1.0 - (2.0 * s / self.width_m) ** 2)
        cosine = toward / np.linalg.norm(rays, axis=-1)
        return CleanView(
            np.where(on, bent, self.wall_m),
            np.where(on, np.clip(cosine, 0.0, 1.0), 1.0),
            np.zeros_like(z),
        )


def frames_of(
    plate: Plate,
    count: int,
    seed: int = 0,
    model: KinectModel | None = None,
    camera: CameraIntrinsics | None = None,
) -> NDArray[np.uint16]:
    """Return (count, height, width) readings in millimetres."""
    camera = camera or kinect_640()
    model = model or KinectModel()
    view = plate.view(camera)
    random = np.random.default_rng([seed, round(1000 * plate.z_m), round(10 * plate.angle_deg)])
    return np.stack([kinect_depth_mm(view, camera, model, random) for _ in range(count)])


def true_sigma_m(model: KinectModel, z_m: float, incidence_rad: float) -> float:
    """Return the model's spread before it takes steps; floor and angle term come behind them."""
    t = incidence_rad / (np.pi / 2.0 - incidence_rad)
    behind = model.floor_sigma_m + 1e-4 / np.sqrt(z_m) * t**2
    before = model.sigma_disparity_px * z_m**2 / model.disparity_px_m
    return float(np.hypot(before, behind))


def true_bias_m(model: KinectModel, z_m: float) -> float:
    """Return reading minus truth of a sensor whose disparity has a constant error."""
    return model.disparity_px_m / (model.disparity_px_m / z_m + model.disparity_bias_px) - z_m


def cropped(camera: CameraIntrinsics, rows: slice, columns: slice) -> CameraIntrinsics:
    """Return the intrinsics of a part of the image."""
    return replace(
        camera,
        width_px=columns.stop - columns.start,
        height_px=rows.stop - rows.start,
        cx_px=camera.cx_px - columns.start,
        cy_px=camera.cy_px - rows.start,
    )


class PlateCamera:
    """Implements `drivers.source.Source`: a few frames of a plate, then the end."""

    name = "depth"

    def __init__(
        self,
        depth_mm: NDArray[np.uint16],
        camera: CameraIntrinsics,
        serial: str = "SIM-1",
    ) -> None:
        self._depth_mm = depth_mm
        self._camera = camera
        self._serial = serial
        self._next = 0

    @property
    def faults(self) -> Faults:
        """None."""
        return NO_FAULTS

    def open(self) -> SourceInfo:
        """Start over."""
        self._next = 0
        return SourceInfo("depth", "simulated Kinect V1", self._serial, (DepthFrame,), "recorded")

    def read(self, timeout_s: float) -> Sequence[Sample]:
        """Give the next frame; 30 a second."""
        if self._next >= len(self._depth_mm):
            raise EndOfSource
        frame = DepthFrame(
            self._next * 33_333_333, self._depth_mm[self._next], self._camera, self._next
        )
        self._next += 1
        return (frame,)

    def close(self) -> None:
        """Nothing is open."""
