"""A depth camera over a height grid: clean views by ray casting, and a Kinect's frames of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.samples import CameraIntrinsics, DepthFrame
from simulation.devices.kinect import (
    CleanView,
    KinectModel,
    in_range,
    kinect_depth_mm,
    lit_by_projector,
)
from simulation.devices.ray_kernels import block_maxima, cast_image
from simulation.errors import SimulationError
from simulation.terrain.height_grid import HeightGrid

Float64Array = NDArray[np.float64]

ZENITH = (0.0, 0.0, 1.0)
# Noise carries readings from a little beyond the range into it.
_BEYOND_RANGE = 1.1


class DepthCamera:
    """A Kinect that looks at a height grid; same seed and frame index, same frame.

    Args:
        ground: what it looks at.
        camera: image size and intrinsics.
        model: the sensor's errors.
        seed: of the noise; 0 or more.
        sun: direction towards the sun in the world; need not have unit length.
    """

    def __init__(
        self,
        ground: HeightGrid,
        camera: CameraIntrinsics,
        model: KinectModel,
        seed: int,
        sun: tuple[float, float, float] = ZENITH,
    ) -> None:
        if seed < 0:
            raise SimulationError(f"seed {seed}; expected 0 or more")
        length = float(np.linalg.norm(sun))
        if not (np.isfinite(length) and length > 0.0):
            raise SimulationError(f"a sun in direction {sun}; expected a vector that is not zero")
        self.ground = ground
        self.camera = camera
        self.model = model
        self.seed = seed
        self._sun = np.array(sun, np.float64) / length
        self._highest = block_maxima(ground.height_m)
        columns = np.arange(camera.width_px, dtype=np.float64)
        rows = np.arange(camera.height_px, dtype=np.float64)
        self._ray_x = (columns - camera.cx_px) / camera.fx_px
        self._ray_y = (rows - camera.cy_px) / camera.fy_px

    def look(self, position_m: Float64Array, rotation: Float64Array) -> CleanView:
        """Return the undisturbed view from a place.

        Args:
            position_m: (3,) camera in the world.
            rotation: (3, 3) optical frame (x right, y down, z forward) to world.
        """
        z_m, cos_incidence, cos_sun = np.empty(
            (3, self.camera.height_px, self.camera.width_px), np.float64
        )
        cast_image(
            self.ground.height_m,
            self._highest,
            (self.ground.origin_x_m, self.ground.origin_y_m, self.ground.spacing_m),
            np.ascontiguousarray(position_m, np.float64),
            np.ascontiguousarray(rotation, np.float64),
            self._ray_x,
            self._ray_y,
            self._sun,
            _BEYOND_RANGE * self.model.range_max_m,
            z_m,
            cos_incidence,
            cos_sun,
        )
        return CleanView(z_m, cos_incidence, cos_sun)

    def frame(self, view: CleanView, index: int, t_ns: int) -> DepthFrame:
        """Return the sensor's frame of a view; `index` chooses its noise and is its sequence."""
        random = np.random.default_rng([self.seed, index])
        depth_mm = kinect_depth_mm(view, self.camera, self.model, random)
        depth_mm.flags.writeable = False
        return DepthFrame(t_ns, depth_mm, self.camera, index)

    def visible_points(
        self,
        view: CleanView,
        position_m: Float64Array,
        rotation: Float64Array,
        wanted: NDArray[np.bool_],
    ) -> Float64Array:
        """Return (N, 3) world points of the wanted pixels that are lit and within the range.

        Args:
            view, position_m, rotation: as given to and by `look`.
            wanted: (height, width) pixels to look at.
        """
        visible = wanted & in_range(view.z_m, self.model)
        visible &= lit_by_projector(view, self.camera, self.model)
        v, u = np.nonzero(visible)
        z = view.z_m[v, u]
        optical = np.column_stack([self._ray_x[u] * z, self._ray_y[v] * z, z])
        return np.asarray(optical @ rotation.T + position_m, np.float64)
