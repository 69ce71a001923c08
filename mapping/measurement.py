"""One depth frame -> one measurement per cell (paper eqs. 3-6 in their corrected form).

p_T = r_TS + C_TS p_S,   h = e . p_T
var(h) = J_S Sigma_S J_S' (per pixel: axial along the ray, lateral across it)
       + J_pose Sigma_pose J_pose' (per cell: the whole frame shares it)
       + bias and mount (per cell: every frame shares them)
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.samples import CameraIntrinsics
from mapping import measurement_kernels as kernels
from mapping.cells.grid import CellWindow
from mapping.cells.update_constants import FrameConstants
from mapping.errors import MappingError
from mapping.geometry import RigidTransform, UncertainPose
from mapping.noise import DepthNoiseModel
from mapping.settings import MapSettings
from mapping.undistortion import Undistortion

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]

# The depth gradient is taken over about +-4 px of a 640 px wide Kinect image (0.4 degrees each
# way): wide enough to look across the sensor's depth steps, narrow enough for a 3 cm edge at 3 m.
_GRADIENT_HALF_ANGLE_RAD = 0.0069

# Lateral noise and correlation area are given for the sensor's own image; see `DepthNoiseModel`.
SENSOR_WIDTH_PX = 640


@dataclass(frozen=True, slots=True)
class View:
    """Where a frame was taken from.

    Attributes:
        body: pose of the tracked body in T with its covariance.
        T_terrain_sensor: the camera's optical frame in T.
    """

    body: UncertainPose
    T_terrain_sensor: RigidTransform


class Readings(NamedTuple):
    """A loaded frame, for those who drop some of its readings by setting them to 0.

    Attributes:
        z_m: (height + 2 margin, width + 2 margin) distance along the optical axis; 0 = none.
        margin_px: width of the margin of zeros.
        ray_x: (width,) x/z of every column. ray_y: (height,) y/z of every row.
    """

    z_m: Float32Array
    margin_px: int
    ray_x: Float32Array
    ray_y: Float32Array


class FrameReducer:
    """Sums a frame's pixels per cell; keeps its work arrays from frame to frame."""

    def __init__(
        self,
        camera: CameraIntrinsics,
        noise: DepthNoiseModel,
        settings: MapSettings,
        undistortion: Undistortion | None = None,
    ) -> None:
        """Make the constants of a camera.

        Raises:
            MappingError: the undistortion is for images of another size.
        """
        if undistortion is not None:
            undistortion.check_camera(camera)
        self._undistortion = undistortion
        self._camera = camera
        self._noise = noise
        self._settings = settings
        self._range = _range_constants(noise)
        self._noise_constants = _noise_constants(noise)
        self._decimation = SENSOR_WIDTH_PX / camera.width_px
        self._focal = kernels.FocalConstants(
            np.float32(camera.fx_px),
            np.float32(camera.fy_px),
            np.float32(1.0 / (camera.fx_px * self._decimation)),
        )
        self._baseline_px = max(1, round(_GRADIENT_HALF_ANGLE_RAD * camera.fx_px))
        self._ray_x, self._ray_y = _rays(camera)
        x, y = self._ray_x[[0, -1]], self._ray_y[[0, -1]]
        corners = [(0.0, 0.0, 0.0), *((a, b, 1.0) for a in x for b in y)]
        self._corners_m = np.array(corners) * noise.range_max_m
        margin = 2 * self._baseline_px
        self._z_m = np.zeros((camera.height_px + margin, camera.width_px + margin), np.float32)
        self._sums = np.zeros((0, 4))

    @property
    def camera(self) -> CameraIntrinsics:
        """The intrinsics that this reducer was made for."""
        return self._camera

    @property
    def noise(self) -> DepthNoiseModel:
        """The noise model that this reducer was made for."""
        return self._noise

    @property
    def readings(self) -> Readings:
        """The loaded frame."""
        return Readings(self._z_m, self._baseline_px, self._ray_x, self._ray_y)

    def footprint(self, view: View) -> CellWindow:
        """Return the cells that the view's frustum can reach.

        All readings lie in the pyramid of the camera and the four corner rays at the largest
        range; the box around its five corners therefore holds them all. One cell more on every
        side, because the kernel's float32 may round a reading on the border outwards.
        """
        points = view.T_terrain_sensor.apply(self._corners_m) / self._settings.resolution_m
        # Five points are sooner looked through in Python than by numpy.
        x, y, _ = points.T.tolist()
        low_x, low_y = math.floor(min(x)), math.floor(min(y))
        high_x, high_y = math.floor(max(x)), math.floor(max(y))
        return CellWindow(low_x - 1, low_y - 1, high_x - low_x + 3, high_y - low_y + 3)

    def load(self, depth_mm: NDArray[np.uint16]) -> int:
        """Take a depth image (height, width) in millimetres; return its valid readings.

        Raises:
            MappingError: the image is not uint16 of the camera's size.
        """
        shape = (self._camera.height_px, self._camera.width_px)
        if depth_mm.dtype != np.uint16 or depth_mm.shape != shape:
            raise MappingError(
                f"depth image is {depth_mm.dtype} of shape {depth_mm.shape}; its camera expects "
                f"uint16 of shape {shape}"
            )
        # numba compiles once more for arrays that are read-only, as a stream's are.
        plain = np.require(depth_mm, requirements=["C", "A", "W"])
        count = kernels.ranges_from_millimetres(plain, self._range, self._baseline_px, self._z_m)
        if self._undistortion is None:
            return count
        inside = self._z_m[self._baseline_px : -self._baseline_px, :]
        inside = inside[:, self._baseline_px : -self._baseline_px]
        noise = self._noise
        return self._undistortion.straighten(inside, noise.range_min_m, noise.range_max_m)

    def reduce(self, view: View, window: CellWindow) -> tuple[Float64Array, int]:
        """Sum the loaded frame over the cells of `window`.

        Returns:
            (cells, 4) sums of weight, weight height, weight height^2 and pixels, heights relative
            to the camera; whoever uses the sums clears them. And the pixels that fell inside.
        """
        cells = window.cells_x * window.cells_y
        if self._sums.shape[0] < cells:
            self._sums = np.zeros((cells, 4))
        added = kernels.accumulate(
            self._z_m,
            self._baseline_px,
            self._ray_x,
            self._ray_y,
            self._focal,
            self._noise_constants,
            _view_constants(view, window, self._settings.resolution_m),
            self._sums,
        )
        return self._sums, added

    def frame_constants(
        self, view: View, window: CellWindow, place: tuple[int, int]
    ) -> FrameConstants:
        """Return what the per-cell update needs; `place` = (row, column) of the window."""
        d = self._settings.resolution_m
        # Single numbers are sooner taken from lists than from arrays.
        x_m, y_m, z_m = view.T_terrain_sensor.translation_m.tolist()
        body_x_m, body_y_m, _ = view.body.transform.translation_m.tolist()
        (r00, r01, r02), (r10, r11, r12), (_, _, r22) = view.T_terrain_sensor.rotation.tolist()
        sigma = view.body.covariance.tolist()
        return FrameConstants(
            t_ns=view.body.t_ns,
            first_column=place[1],
            first_row=place[0],
            cells_x=window.cells_x,
            cells_y=window.cells_y,
            cell_size_m=d,
            corner_x_m=window.first_x * d - x_m,
            corner_y_m=window.first_y * d - y_m,
            camera_x_m=x_m,
            camera_y_m=y_m,
            camera_z_m=z_m,
            lever_x_m=x_m - body_x_m,
            lever_y_m=y_m - body_y_m,
            r00=r00,
            r01=r01,
            r02=r02,
            r10=r10,
            r11=r11,
            r12=r12,
            r22=r22,
            pose_zz=sigma[2][2],
            pose_za=sigma[2][3],
            pose_zb=sigma[2][4],
            pose_aa=sigma[3][3],
            pose_ab=sigma[3][4],
            pose_bb=sigma[4][4],
            mount_rad=self._settings.mount_sigma_rad,
            bias_0_m=self._noise.bias_sigma_m,
            bias_2_per_m=self._noise.bias_sigma_quadratic_per_m,
            correlation_area_px=max(self._noise.correlation_area_px / self._decimation**2, 1.0),
            range_min_m=self._noise.range_min_m,
            fixed_share=self._noise.fixed_share,
        )


def _rays(camera: CameraIntrinsics) -> tuple[Float32Array, Float32Array]:
    """Return x/z of every column and y/z of every row."""
    columns = (np.arange(camera.width_px) - camera.cx_px) / camera.fx_px
    rows = (np.arange(camera.height_px) - camera.cy_px) / camera.fy_px
    return columns.astype(np.float32), rows.astype(np.float32)


def _range_constants(noise: DepthNoiseModel) -> kernels.RangeConstants:
    values = (
        noise.bias_m,
        noise.bias_slope,
        noise.bias_quadratic_per_m,
        noise.range_min_m,
        noise.range_max_m,
    )
    return kernels.RangeConstants(*(np.float32(value) for value in values))


def _noise_constants(noise: DepthNoiseModel) -> kernels.NoiseConstants:
    values = (
        noise.axial_offset_m,
        noise.axial_quadratic_per_m,
        noise.axial_reference_m,
        noise.axial_angle_m_sqrt_m,
        noise.quantum_per_m**2 / 12.0,
        noise.lateral_offset_px,
        noise.lateral_angle_px,
    )
    return kernels.NoiseConstants(*(np.float32(value) for value in values))


def _view_constants(view: View, window: CellWindow, cell_size_m: float) -> kernels.ViewConstants:
    rotation = view.T_terrain_sensor.rotation
    camera = view.T_terrain_sensor.translation_m
    values = (
        *rotation.ravel().tolist(),
        float(camera[0]) / cell_size_m - window.first_x,
        float(camera[1]) / cell_size_m - window.first_y,
        1.0 / cell_size_m,
    )
    constants = np.array(values, np.float32)
    return kernels.ViewConstants._make([*constants, window.cells_x, window.cells_y])
