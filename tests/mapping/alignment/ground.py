"""A small camera over made ground, a map built from true poses, and perturbed priors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mapping.alignment.fusion import moved
from mapping.alignment.scan_to_map import Alignment, ScanAligner
from mapping.alignment.settings import AlignmentSettings
from mapping.cells.grid import Grid, make_grid
from mapping.cells.update_constants import fusion_constants
from mapping.cells.update_kernels import fuse
from mapping.geometry import RigidTransform, UncertainPose
from mapping.measurement import FrameReducer, View
from mapping.motion.ledger import at_rest
from mapping.noise import NGUYEN_2012
from mapping.settings import MapSettings
from simulation.devices.camera_mount import on_rover
from simulation.devices.depth_camera import DepthCamera
from simulation.devices.kinect import KinectModel, kinect_320
from simulation.terrain.height_grid import HeightGrid

Float64Array = NDArray[np.float64]

CAMERA = kinect_320()
MOUNT = RigidTransform(on_rover().rotation, on_rover().position_m)
SETTINGS = AlignmentSettings()


def plane(slope: float) -> Callable[[Float64Array, Float64Array], Float64Array]:
    """Return a plane that rises along x."""
    return lambda x, y: slope * x + 0.0 * y


def bumps(x: Float64Array, y: Float64Array) -> Float64Array:
    """Return waves of 3 cm in both directions."""
    heights: Float64Array = 0.03 * np.sin(4.0 * x + 0.5) * np.cos(3.5 * y)
    return heights


@dataclass
class Site:
    """Ground, camera, map.

    Attributes:
        height: of the ground.
        settings: of the map.
        alignment: of the alignment.
    """

    height: Callable[[Float64Array, Float64Array], Float64Array]
    settings: MapSettings = field(default_factory=MapSettings)
    alignment: AlignmentSettings = SETTINGS

    def __post_init__(self) -> None:
        axis = np.arange(-1.0, 6.0, 0.02)
        x, y = np.meshgrid(axis, axis - 2.5)
        grid = HeightGrid(-1.0, -3.5, 0.02, self.height(x, y).astype(np.float32))
        self._camera = DepthCamera(grid, CAMERA, KinectModel(), 1)
        self._fusion = fusion_constants(self.settings)
        self._index = 0
        self.grid: Grid = make_grid(self.settings)
        self.reducer = FrameReducer(CAMERA, NGUYEN_2012, self.settings)
        self.aligner = ScanAligner(self.alignment, self.settings.resolution_m)

    def pose(self, x_m: float, yaw_deg: float = 0.0, pitch_deg: float = 0.0) -> RigidTransform:
        """Return a pose of the rover on the ground."""
        z = float(self.height(np.array(x_m), np.array(0.0)))
        turn = Rotation.from_euler("ZY", [yaw_deg, pitch_deg], degrees=True)
        return RigidTransform(turn.as_matrix(), np.array([x_m, 0.0, z]))

    def look(self, pose: RigidTransform) -> None:
        """Load the frame that is seen from a pose."""
        camera = pose @ MOUNT
        view = self._camera.look(camera.translation_m, camera.rotation)
        self.reducer.load(self._camera.frame(view, self._index, 0).depth_mm)
        self._index += 1

    def add(self, pose: RigidTransform) -> None:
        """Map the loaded frame from a pose."""
        view = self.view(pose)
        window = self.grid.prepare(self.reducer.footprint(view), *pose.translation_m[:2])
        sums, _ = self.reducer.reduce(view, window)
        constants = self.reducer.frame_constants(view, window, self.grid.position(window))
        fuse(sums, constants, self._fusion, self.grid.layers, at_rest())

    def build(self, frames: int = 5) -> None:
        """Map frames from true poses, while the rover moves 2 cm and turns a degree each time."""
        for n in range(frames):
            pose = self.pose(0.02 * n, n - frames / 2.0)
            self.look(pose)
            self.add(pose)

    def view(self, pose: RigidTransform) -> View:
        """Return the view of the camera from a pose of the rover."""
        body = UncertainPose(self._index * 100_000_000, pose, np.zeros((6, 6)))
        return View(body, pose @ MOUNT)

    def align(self, truth: RigidTransform, error: Float64Array) -> Alignment | None:
        """Align a new frame taken at `truth`, from a prior that is off by (6,) m and rad."""
        self.look(truth)
        return self.aligner.align(self.reducer, self.view(moved(truth, error)), self.grid)
