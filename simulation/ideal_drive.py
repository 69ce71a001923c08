"""A rover's camera on a known path over analytic terrain, as a source of poses and depth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from drivers.errors import DriverError, EndOfSource
from drivers.faults import NO_FAULTS, Faults
from drivers.samples import DepthFrame, PoseSample, Sample, frozen_array
from drivers.source import SourceInfo
from simulation.devices.camera_mount import BODY_FROM_OPTICAL
from simulation.devices.ideal_camera import noisy_depth_mm, trace
from simulation.devices.kinect import kinect_320
from simulation.motion import START_NS
from simulation.terrain.analytic import AnalyticTerrain, crater_field
from simulation.truth import SeenCells, Truth

Float64Array = NDArray[np.float64]

_CAMERA_HEIGHT_M = 0.40
_CAMERA_PITCH_RAD = float(np.radians(25.0))
_SPEED_M_S = 0.3
_Z_MAX_M = 4.5
_FRAME_PERIOD_NS = 100_000_000
_POSES_PER_FRAME = 5


class IdealDrive:
    """Source of exact poses (50 Hz) and noisy depth (10 Hz) on a winding drive.

    The tracked body is the camera itself. The camera rides 0.40 m above the ground, 25 degrees
    down, and pitches, rolls and turns as it goes.

    Args:
        seed: terrain and noise; same seed, same samples.
        duration_s: length of the drive.
        name: the instance's name.

    Raises:
        DriverError: a negative seed, or an impossible duration.
    """

    def __init__(self, seed: int, duration_s: float, name: str = "ideal_drive") -> None:
        if not 0.2 <= duration_s <= 3600.0:
            raise DriverError(f"a drive of {duration_s} s; expected 0.2 to 3600 s")
        if seed < 0:
            raise DriverError(f"seed {seed}; expected 0 or more")
        self.name = name
        self.frames = round(duration_s * 1e9 / _FRAME_PERIOD_NS)
        self.camera = kinect_320()
        self.terrain: AnalyticTerrain = crater_field(seed, duration_s * _SPEED_M_S + 3.5, 4.0)
        self._seed = seed
        self._hits: dict[int, Float64Array] = {}
        self._next: int | None = None
        self._given = 0

    @property
    def faults(self) -> Faults:
        """None: nothing is lost on the way from a simulated device."""
        return NO_FAULTS

    def open(self) -> SourceInfo:
        """Start at the beginning of the drive."""
        self._next = self._given = 0
        return SourceInfo(
            name=self.name,
            model="simulated ideal camera",
            serial="",
            produces=(PoseSample, DepthFrame),
            time_base="recorded",
            details={"seed": str(self._seed), "frames": str(self.frames)},
            nominal_rate_hz={PoseSample: 50.0, DepthFrame: 10.0},
        )

    def read(self, timeout_s: float) -> Sequence[Sample]:  # noqa: ARG002 - never waits
        """Return the poses up to the next depth frame, and that frame.

        Raises:
            DriverError: not open.
            EndOfSource: the drive is over.
        """
        if self._next is None:
            raise DriverError(f"{self.name}: read before open")
        if self._next >= self.frames:
            raise EndOfSource(f"{self.name}: end of the drive")
        index = self._next
        first = index * _POSES_PER_FRAME - (_POSES_PER_FRAME - 1 if index else 0)
        poses = [self._pose(i) for i in range(first, index * _POSES_PER_FRAME + 1)]
        frame = self.depth_frame(index, index * _FRAME_PERIOD_NS)
        self._next = self._given = index + 1
        return [*poses, frame]

    def close(self) -> None:
        """Forget where the drive was; harmless when closed."""
        self._next = None

    def truth(self, cell_size_m: float, range_min_m: float, range_max_m: float) -> Truth:
        """Return the terrain on cells of that size around everything that was seen so far."""
        seen = SeenCells(cell_size_m)
        for index in range(self._given):
            hits = self._hits[index]
            seen.add(hits[(hits[:, 2] >= range_min_m) & (hits[:, 2] <= range_max_m)])
        return seen.truth(self.terrain.height_m)

    def body_pose(self, t_ns: int) -> tuple[Float64Array, Float64Array]:
        """Return position (3,) and rotation (3, 3) of the optical frame, t_ns after the start."""
        t_s = t_ns * 1e-9
        x = _SPEED_M_S * t_s
        y = 0.35 * np.sin(0.5 * t_s)
        yaw = np.arctan2(0.175 * np.cos(0.5 * t_s), _SPEED_M_S) * 0.8
        pitch = _CAMERA_PITCH_RAD + np.radians(2.0) * np.sin(1.7 * t_s)
        roll = np.radians(2.0) * np.sin(1.1 * t_s + 0.5)
        ground = float(self.terrain.height_m(np.array(x), np.array(y)))
        body = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
        return np.array([x, y, ground + _CAMERA_HEIGHT_M]), body @ BODY_FROM_OPTICAL

    def depth_frame(self, index: int, t_ns: int) -> DepthFrame:
        """Return the noisy frame of that number, and remember what it saw."""
        position, rotation = self.body_pose(t_ns)
        z_m, incidence = trace(self.terrain, self.camera, position, rotation, _Z_MAX_M)
        self._hits[index] = self._points(z_m, position, rotation)
        random = np.random.default_rng([self._seed, index])
        depth_mm = noisy_depth_mm(z_m, incidence, random)
        depth_mm.flags.writeable = False
        return DepthFrame(START_NS + t_ns, depth_mm, self.camera, index)

    def _pose(self, index: int) -> PoseSample:
        t_ns = index * _FRAME_PERIOD_NS // _POSES_PER_FRAME
        position, rotation = self.body_pose(t_ns)
        quat = Rotation.from_matrix(rotation).as_quat(scalar_first=True)
        return PoseSample(
            START_NS + t_ns,
            frozen_array(position, (3,)),
            frozen_array(quat, (4,)),
            frozen_array(np.zeros((6, 6)), (6, 6)),
            index,
        )

    def _points(
        self, z_m: Float64Array, position: Float64Array, rotation: Float64Array
    ) -> Float64Array:
        """Return (N, 3): world x, world y and distance along the axis of every ray that hit."""
        v, u = np.nonzero(z_m)
        z = z_m[v, u]
        x = (u - self.camera.cx_px) / self.camera.fx_px * z
        y = (v - self.camera.cy_px) / self.camera.fy_px * z
        world = np.stack([x, y, z], axis=-1) @ rotation.T + position
        return np.column_stack([world[:, :2], z]).astype(np.float32)
