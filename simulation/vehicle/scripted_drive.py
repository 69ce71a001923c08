"""A drive along given poses over a height grid, seen by the simulated Kinect."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from drivers.errors import DriverError
from drivers.samples import DepthFrame
from simulation.devices.camera_mount import CameraMount, camera_is_body
from simulation.devices.depth_camera import DepthCamera
from simulation.drive_source import FRAME_PERIOD_NS, DriveSource
from simulation.errors import SimulationError
from simulation.motion import START_NS
from simulation.truth import SeenCells, Truth

Float64Array = NDArray[np.float64]
Int64Array = NDArray[np.int64]


class PosePath:
    """Poses of a body over time; linear between them, along the shortest turn.

    Args:
        t_ns: (N,) int64, strictly increasing, from 0 at the start of the drive; N >= 2.
        position_m: (N, 3) in the world, z up.
        quat_wxyz: (N, 4) body axes to world axes; need not have unit length.

    Raises:
        SimulationError: the arrays do not fit together or are not finite.
    """

    def __init__(self, t_ns: Int64Array, position_m: Float64Array, quat_wxyz: Float64Array) -> None:
        number = t_ns.size
        if t_ns.shape != (number,) or number < 2 or t_ns[0] != 0 or np.any(np.diff(t_ns) <= 0):
            raise SimulationError(
                f"a path with times of shape {t_ns.shape}; expected two or more, from 0, increasing"
            )
        if position_m.shape != (number, 3) or quat_wxyz.shape != (number, 4):
            raise SimulationError(
                f"a path with {number} times, positions {position_m.shape} and quaternions "
                f"{quat_wxyz.shape}; expected ({number}, 3) and ({number}, 4)"
            )
        lengths = np.linalg.norm(quat_wxyz, axis=1)
        if not (np.isfinite(position_m).all() and np.isfinite(lengths).all() and lengths.all()):
            raise SimulationError("a path with poses that are not finite, or quaternions of zero")
        self.t_ns = t_ns
        self.position_m = position_m
        self.quat_wxyz = quat_wxyz
        self._turn = Slerp(t_ns, Rotation.from_quat(quat_wxyz, scalar_first=True))

    @property
    def duration_ns(self) -> int:
        """Return the time of the last pose."""
        return int(self.t_ns[-1])

    def at(self, t_ns: int) -> tuple[Float64Array, Float64Array]:
        """Return position (3,) and rotation (3, 3) at a time of the path."""
        position = np.array([np.interp(t_ns, self.t_ns, axis) for axis in self.position_m.T])
        return position, np.asarray(self._turn(t_ns).as_matrix(), np.float64)


class ScriptedDrive(DriveSource):
    """Exact poses of a body (50 Hz) and the Kinect's depth (10 Hz) on its way.

    Args:
        camera: looks at the ground; its seed is that of the noise.
        path: poses of the tracked body.
        mount: of the camera on that body; by default the camera is the body.
        name: the instance's name.

    Raises:
        DriverError: the path is shorter than two frames.
    """

    def __init__(
        self,
        camera: DepthCamera,
        path: PosePath,
        mount: CameraMount | None = None,
        name: str = "scripted_drive",
    ) -> None:
        frames = path.duration_ns // FRAME_PERIOD_NS + 1
        if frames < 2:
            raise DriverError(f"a drive of {path.duration_ns * 1e-9} s; expected 0.1 s or more")
        super().__init__(name, "simulated Kinect V1", frames, {"seed": str(camera.seed)})
        self.camera = camera.camera
        self._eye = camera
        self._path = path
        self._mount = camera_is_body() if mount is None else mount

    def body_pose(self, t_ns: int) -> tuple[Float64Array, Float64Array]:
        """Return position (3,) and rotation (3, 3) of the tracked body, t_ns after the start."""
        return self._path.at(t_ns)

    def depth_frame(self, index: int, t_ns: int) -> DepthFrame:
        """Return the Kinect's frame of that number."""
        view = self._eye.look(*self._camera_pose(t_ns))
        return self._eye.frame(view, index, START_NS + t_ns)

    def truth(self, cell_size_m: float, range_min_m: float, range_max_m: float) -> Truth:
        """Return the ground on cells of that size around everything the frames so far showed.

        Looks again from all their places, about 20 ms a frame. What is in the projector's shadow
        or beyond the sensor's own range was not visible.

        Raises:
            SimulationError: nothing was seen within the range.
        """
        seen = SeenCells(cell_size_m)
        for index in range(self.frames_given):
            pose = self._camera_pose(index * FRAME_PERIOD_NS)
            view = self._eye.look(*pose)
            within = (view.z_m >= range_min_m) & (view.z_m <= range_max_m)
            seen.add(self._eye.visible_points(view, *pose, within))
        return seen.truth(self._eye.ground.height_at)

    def _camera_pose(self, t_ns: int) -> tuple[Float64Array, Float64Array]:
        return self._mount.camera_pose(*self._path.at(t_ns))
