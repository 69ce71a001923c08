"""A rover's camera on a known path over analytic terrain, as a source of poses and depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from drivers.errors import DriverError, EndOfSource
from drivers.samples import CameraIntrinsics, DepthFrame, PoseSample, Sample, frozen_array
from drivers.source import SourceInfo
from simulation.ideal_camera import noisy_depth_mm, trace
from simulation.terrain import AnalyticTerrain, crater_field

Float64Array = NDArray[np.float64]

# 2026-01-01 00:00 UTC: simulated stamps look like recorded ones, and never depend on the clock.
START_NS = 1_767_225_600_000_000_000
FRAME_PERIOD_NS = 100_000_000
_POSES_PER_FRAME = 5
_CAMERA_HEIGHT_M = 0.40
_CAMERA_PITCH_RAD = float(np.radians(25.0))
_SPEED_M_S = 0.3
_Z_MAX_M = 4.5
_RAYS_TO_BE_VISIBLE = 4
# Optical frame (x right, y down, z forward) to a body looking along x with z up.
_BODY_FROM_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def kinect_320() -> CameraIntrinsics:
    """Return a Kinect V1 decimated to 320 x 240: 57 x 43 degrees."""
    return CameraIntrinsics(320, 240, 290.0, 290.0, 159.5, 119.5)


@dataclass(frozen=True, slots=True)
class Truth:
    """What the mapper must not know.

    Attributes:
        x_m, y_m: cell centres, increasing.
        height_m: (y, x) terrain height at the centres.
        visible: (y, x) cells that at least four undisturbed rays within the camera's range met.
    """

    x_m: Float64Array
    y_m: Float64Array
    height_m: Float64Array
    visible: NDArray[np.bool_]


class IdealDrive:
    """Source of exact poses (50 Hz) and noisy depth (10 Hz) on a winding drive.

    The tracked body is the camera itself. The camera rides 0.40 m above the ground, 25 degrees
    down, and pitches, rolls and turns as it goes.

    Args:
        seed: terrain and noise; same seed, same samples.
        duration_s: length of the drive.
        name: the instance's name.
    """

    def __init__(self, seed: int, duration_s: float, name: str = "ideal_drive") -> None:
        if not 0.2 <= duration_s <= 3600.0:
            raise DriverError(f"a drive of {duration_s} s; expected 0.2 to 3600 s")
        if seed < 0:
            raise DriverError(f"seed {seed}; expected 0 or more")
        self.name = name
        self.camera = kinect_320()
        self.terrain: AnalyticTerrain = crater_field(seed, duration_s * _SPEED_M_S + 3.5, 4.0)
        self._seed = seed
        self.frames = round(duration_s * 1e9 / FRAME_PERIOD_NS)
        self._next: int | None = None
        self._seen: list[NDArray[np.float32]] = []

    def open(self) -> SourceInfo:
        """Start at the beginning of the drive."""
        self._next = 0
        self._seen = []
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
        self._next += 1
        first = index * _POSES_PER_FRAME - (_POSES_PER_FRAME - 1 if index else 0)
        poses = [self._pose(i) for i in range(first, index * _POSES_PER_FRAME + 1)]
        return [*poses, self._frame(index)]

    def close(self) -> None:
        """Forget where the drive was; harmless when closed."""
        self._next = None

    def truth(self, cell_size_m: float, range_min_m: float, range_max_m: float) -> Truth:
        """Return the terrain on cells of that size around everything that was seen so far.

        Raises:
            DriverError: nothing was seen within that range.
        """
        met = [
            _count_cells(self._hits(index, z_m, range_min_m, range_max_m), cell_size_m)
            for index, z_m in enumerate(self._seen)
        ]
        cells = np.concatenate([np.empty((0, 3), np.int64), *met])
        if not len(cells):
            raise DriverError(f"{self.name}: nothing seen in that range; read frames before truth")
        first = cells[:, :2].min(axis=0)
        columns, rows = cells[:, :2].max(axis=0) - first + 1
        rays = np.zeros((rows, columns), np.int64)
        np.add.at(rays, (cells[:, 1] - first[1], cells[:, 0] - first[0]), cells[:, 2])
        x_m = (first[0] + np.arange(columns) + 0.5) * cell_size_m
        y_m = (first[1] + np.arange(rows) + 0.5) * cell_size_m
        height_m = self.terrain.height_m(x_m[np.newaxis, :], y_m[:, np.newaxis])
        return Truth(x_m, y_m, height_m, rays >= _RAYS_TO_BE_VISIBLE)

    def camera_pose(self, t_s: float) -> tuple[Float64Array, Float64Array]:
        """Return position (3,) and rotation (3, 3) of the optical frame, t_s after the start."""
        x = _SPEED_M_S * t_s
        y = 0.35 * np.sin(0.5 * t_s)
        yaw = np.arctan2(0.175 * np.cos(0.5 * t_s), _SPEED_M_S) * 0.8
        pitch = _CAMERA_PITCH_RAD + np.radians(2.0) * np.sin(1.7 * t_s)
        roll = np.radians(2.0) * np.sin(1.1 * t_s + 0.5)
        ground = float(self.terrain.height_m(np.array(x), np.array(y)))
        body = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
        return np.array([x, y, ground + _CAMERA_HEIGHT_M]), body @ _BODY_FROM_OPTICAL

    def _pose(self, index: int) -> PoseSample:
        t_ns = index * FRAME_PERIOD_NS // _POSES_PER_FRAME
        position, rotation = self.camera_pose(t_ns * 1e-9)
        quat = Rotation.from_matrix(rotation).as_quat(scalar_first=True)
        return PoseSample(
            START_NS + t_ns,
            frozen_array(position, (3,)),
            frozen_array(quat, (4,)),
            frozen_array(np.zeros((6, 6)), (6, 6)),
            index,
        )

    def _frame(self, index: int) -> DepthFrame:
        t_ns = index * FRAME_PERIOD_NS
        position, rotation = self.camera_pose(t_ns * 1e-9)
        z_m, incidence = trace(self.terrain, self.camera, position, rotation, _Z_MAX_M)
        self._seen.append(z_m.astype(np.float32))
        random = np.random.default_rng([self._seed, index])
        depth_mm = noisy_depth_mm(z_m, incidence, random)
        depth_mm.flags.writeable = False
        return DepthFrame(START_NS + t_ns, depth_mm, self.camera, index)

    def _hits(
        self, index: int, z_m: NDArray[np.float32], range_min_m: float, range_max_m: float
    ) -> Float64Array:
        """Return (N, 2) world x and y of the rays of a frame that met ground in that range."""
        position, rotation = self.camera_pose(index * FRAME_PERIOD_NS * 1e-9)
        v, u = np.nonzero((z_m >= range_min_m) & (z_m <= range_max_m))
        z = z_m[v, u].astype(np.float64)
        x = (u - self.camera.cx_px) / self.camera.fx_px * z
        y = (v - self.camera.cy_px) / self.camera.fy_px * z
        points = np.stack([x, y, z], axis=-1) @ rotation.T + position
        return points[:, :2]


def _count_cells(points_m: Float64Array, cell_size_m: float) -> NDArray[np.int64]:
    """Return (K, 3): column, row and number of points of every cell that holds some."""
    if not len(points_m):
        return np.empty((0, 3), np.int64)
    cells = np.floor(points_m / cell_size_m).astype(np.int64)
    first = cells.min(axis=0)
    columns = int(cells[:, 0].max() - first[0]) + 1
    count = np.bincount((cells[:, 1] - first[1]) * columns + cells[:, 0] - first[0])
    some = np.flatnonzero(count)
    return np.column_stack([some % columns + first[0], some // columns + first[1], count[some]])
