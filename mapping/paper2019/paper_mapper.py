"""A mapper that follows the paper: same input, same cells, the printed equations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.messages.frames import BASE_FRAME, DEPTH_OPTICAL_FRAME
from drivers.samples import DepthFrame
from mapping.cells.elevation_map import CellState, ElevationMap
from mapping.cells.grid import CellWindow
from mapping.errors import MappingError
from mapping.geometry import UncertainPose
from mapping.mapper import Mapper
from mapping.measurement import View
from mapping.noise import DepthNoiseModel
from mapping.paper2019.cells import PaperCells
from mapping.paper2019.faults import describe_faults
from mapping.poses.choice import is_aligned
from mapping.settings import MapSettings

Float64Array = NDArray[np.float64]

# Parts of a map's variance that the paper does not know: 0.
_OTHER_PARTS = tuple(
    item.name
    for item in fields(ElevationMap)
    if item.name.endswith("_m2") and item.name not in {"variance_m2", "independent_m2"}
)


class PaperMapper(Mapper):
    """Eqs. 11-17 for every frame, eqs. 28-32 for every motion between two frames.

    What the paper leaves open is read as simply as possible. A point's variance is eq. 6: sensor
    noise as the corrected mode has it, and the rotation's share. The covariance of the step from
    frame to frame (eqs. 33, 34) is that of the pose at its end. The rover's frame is base_link,
    or, where the recording does not have it, the tracked body.
    """

    def __init__(
        self,
        settings: MapSettings,
        noise: DepthNoiseModel,
        on_pose: Callable[[UncertainPose], None] = lambda _: None,
    ) -> None:
        """Start with an empty map; `on_pose` is told the pose of every frame that is mapped.

        Raises:
            MappingError: as `Mapper`; or the settings ask for a scrolling grid or alignment.
        """
        if is_aligned(settings):
            raise MappingError(
                f"pose_source is {settings.pose_source!r}; paper2019 aligns nothing: give mocap or "
                "ego-motion"
            )
        if settings.grid != "growing":
            raise MappingError(
                f"grid is {settings.grid!r}; paper2019 has no window: give --grid growing"
            )
        super().__init__(settings, noise, on_pose=on_pose)
        self._cells = PaperCells(settings)

    def read_map(self, attributes: Mapping[str, str | int | float]) -> ElevationMap:
        """Return the map as it is now; its variance is zz of the covariance alone.

        Raises:
            MappingError: no reading has reached the map.
        """
        cells, d = self._cells, self.settings.resolution_m
        seen = cells.frames > 0
        if not seen.any():
            raise MappingError("no depth reading reached the map; check the range limits")
        rows, columns = (np.flatnonzero(seen.any(axis=axis)) for axis in (1, 0))
        box = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
        seen, frames, pixels = seen[box], cells.frames[box], cells.pixels[box]
        unknown = ~seen[..., np.newaxis, np.newaxis]
        covariance = np.where(unknown, np.nan, cells.covariance_m2[box]).astype(np.float32)
        # An array of its own for each: numba compiles once more for views with steps.
        xx, xy, yy, variance = (
            np.ascontiguousarray(covariance[..., row, column])
            for row, column in ((0, 0), (0, 1), (1, 1), (2, 2))
        )
        places: dict[str, Any] = {
            "horizontal_xx_m2": xx,
            "horizontal_xy_m2": xy,
            "horizontal_yy_m2": yy,
        }
        nothing: Any = np.where(seen, np.float32(0.0), np.float32(np.nan))
        few = (frames < self.settings.confirmed_frames) | (pixels < self.settings.confirmed_pixels)
        vague = variance >= self.settings.uncertain_sigma_m**2
        state = np.select(
            [~seen, few, vague],
            [CellState.UNKNOWN, CellState.UNCONFIRMED, CellState.UNCERTAIN],
            CellState.MEASURED,
        )
        return ElevationMap(
            resolution_m=d,
            x_m=(cells.extent.first_x + np.arange(columns[0], columns[-1] + 1) + 0.5) * d,
            y_m=(cells.extent.first_y + np.arange(rows[0], rows[-1] + 1) + 0.5) * d,
            elevation_m=np.where(seen, cells.height_m[box], np.nan).astype(np.float32),
            variance_m2=variance,
            independent_m2=variance,
            **(dict.fromkeys(_OTHER_PARTS, nothing) | places),
            frames=frames,
            pixels=pixels,
            last_seen_ns=cells.last_ns[box],
            state=state.astype(np.uint8),
            attributes={**attributes, "method": "paper2019", "method_faults": describe_faults()},
        )

    def _map(self, frame: DepthFrame, pose: UncertainPose) -> None:
        """One depth frame's walk: the motion since the last one, then the measurement."""
        (reducer,) = self._readers.of(frame.camera)
        mount = self._mounts.lookup(self.body_frame, DEPTH_OPTICAL_FRAME)
        view = View(pose, pose.transform @ mount)
        readings = reducer.load(frame.depth_mm)
        window = reducer.footprint(view)
        self._cells.cover(window)
        self._move(pose)
        sums, inside = reducer.reduce(view, window)
        shape = (window.cells_y, window.cells_x)
        count = window.cells_x * window.cells_y
        weight, weighted, _, pixels = sums[:count].T.reshape(4, *shape).copy()
        sums[:count] = 0.0
        filled = np.maximum(weight, np.finfo(float).tiny)
        height_m = weighted / filled + view.T_terrain_sensor.translation_m[2]
        pixel_m2 = pixels / filled + self._rotation_m2(view, window)
        self.counts.updates += self._cells.update(window, height_m, pixel_m2, pixels, frame.t_ns)
        self.counts.frames += 1
        self.counts.readings += readings
        self.counts.readings_outside += readings - inside
        self._on_pose(pose)

    def _move(self, pose: UncertainPose) -> None:
        """Eq. 28 with the covariance of this pose as that of the step that led to it."""
        rover = pose.transform
        if self._mounts.connects(self.body_frame, BASE_FRAME):
            rover = rover @ self._mounts.lookup(self.body_frame, BASE_FRAME)
        c_tr = rover.rotation
        step_m2 = c_tr.T @ pose.covariance[:3, :3] @ c_tr
        self._cells.move(c_tr, rover.translation_m, step_m2, float(pose.covariance[5, 5]))

    def _rotation_m2(self, view: View, window: CellWindow) -> Float64Array:
        """Return J_Phi S_Phi J_Phi' of eqs. 5 and 6 at the cells' centres.

        J_Phi = e' C_TS (r_SP)^x; in terrain axes (e x r)' = (-r_y, r_x, 0).
        """
        d, camera = self.settings.resolution_m, view.T_terrain_sensor.translation_m
        x = (np.arange(window.first_x, window.first_x + window.cells_x) + 0.5) * d - camera[0]
        y = (np.arange(window.first_y, window.first_y + window.cells_y) + 0.5) * d - camera[1]
        x, y = np.meshgrid(x, y)
        s = view.body.covariance[3:, 3:]
        found: Float64Array = y * y * s[0, 0] - 2.0 * x * y * s[0, 1] + x * x * s[1, 1]
        return found
