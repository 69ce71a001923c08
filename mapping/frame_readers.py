"""Reads depth frames into sums per cell, and sets aside what is not the ground.

A calibration covers the distances it was made at. The readings in front of and behind them are
read with a fallback's noise: one reducer for each stretch of distances, all for the same frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from drivers.samples import CameraIntrinsics, DepthFrame
from mapping.cells.cell_layers import CellLayers
from mapping.cells.grid import CellWindow
from mapping.cells.update_constants import FrameConstants
from mapping.change.hidden import mark_hidden
from mapping.change.overhang import drop_overhangs
from mapping.change.own_body import drop_own_body
from mapping.change.visibility import clear_seen_through, sight_of
from mapping.errors import MappingError
from mapping.geometry import RigidTransform
from mapping.mapper_counts import MapperCounts
from mapping.measurement import Float64Array, FrameReducer, View
from mapping.noise import DepthNoiseModel
from mapping.settings import MapSettings
from mapping.undistortion import Undistortion

FloatArray = TypeVar("FloatArray", NDArray[np.float32], NDArray[np.float64])


class FrameReaders:
    """The reducers of the depth camera in use, and what they do with a frame.

    Attributes:
        noise: of the depth camera, within the settings' range.
        undistortion: what is taken off its readings; None = nothing.
    """

    def __init__(
        self,
        settings: MapSettings,
        noise: DepthNoiseModel,
        fallback: DepthNoiseModel | None,
        undistortion: Undistortion | None,
        counts: MapperCounts,
    ) -> None:
        """Choose the stretches of distances.

        Args:
            settings: of the map.
            noise: of the depth camera; holds within its own range.
            fallback: noise of readings that the settings want and `noise` does not cover;
                None = such readings are not read.
            undistortion: what to take off the readings.
            counts: where it is counted what became of the readings.

        Raises:
            MappingError: the ranges of settings and noise model have nothing in common.
        """
        self.noise = _within_both_ranges(settings, noise)
        self.undistortion = undistortion
        self._settings = settings
        self._fallbacks = _around(self.noise, settings, fallback)
        self._counts = counts
        self._reducers: list[FrameReducer] = []

    def of(self, camera: CameraIntrinsics) -> Sequence[FrameReducer]:
        """Return the reducers for this camera, the calibrated one first.

        Raises:
            MappingError: the undistortion is for images of another size.
        """
        if not self._reducers or self._reducers[0].camera != camera:
            self._counts.camera_changes += bool(self._reducers)
            noises = [self.noise, *self._fallbacks]
            self._reducers = [
                FrameReducer(camera, noise, self._settings, self.undistortion) for noise in noises
            ]
        return self._reducers

    def load(self, reducer: FrameReducer, frame: DepthFrame, mount: RigidTransform | None) -> int:
        """Take a frame's readings; return how many are left without those of the rover itself.

        Args:
            reducer: whose distances are taken.
            frame: the depth image.
            mount: the camera's optical frame in the rover frame; None = the rover is not in view.

        Raises:
            MappingError: the image is not uint16 of the camera's size.
        """
        count = reducer.load(frame.depth_mm)
        if mount is None:
            return count
        dropped = drop_own_body(reducer.readings, self._settings.body_boxes_m, mount)
        self._counts.readings_own_body += dropped
        return count - dropped

    def reduce(
        self,
        reducer: FrameReducer,
        readings: int,
        view: View,
        window: CellWindow,
        constants: FrameConstants,
        layers: CellLayers,
    ) -> Float64Array:
        """Return the sums over the window, (cells, 4), of the `readings` that a reducer took.

        What hangs high above the ground that `layers` know is dropped before.
        """
        if self._settings.overhang_clearance_m > 0.0:
            dropped = drop_overhangs(reducer.readings, view, constants, layers, self._settings)
            self._counts.readings_overhanging += dropped
            readings -= dropped
        sums, inside = reducer.reduce(view, window)
        self._counts.readings += readings
        self._counts.readings_outside += readings - inside
        if reducer is not self._reducers[0]:
            self._counts.readings_uncalibrated += readings
        return sums[: window.cells_x * window.cells_y]

    def look_around(
        self,
        frame: DepthFrame,
        view: View,
        sums: Sequence[Float64Array],
        constants: FrameConstants,
        layers: CellLayers,
    ) -> None:
        """Forget cells that frames have looked through; mark those that are hidden from this.

        Args:
            frame: the depth image.
            view: where it was taken from.
            sums: of each reducer, as `reduce` returned them.
            constants: of the frame.
            layers: the cells; changed in place.
        """
        limit = self._settings.seen_through_frames
        if limit:
            sight = sight_of(frame.camera, self.noise, view, limit)
            self._counts.cleared += clear_seen_through(
                frame.depth_mm, _together(sums), constants, sight, layers
            )
            whole = _together([reducer.readings.z_m for reducer in self._reducers])
            readings = self._reducers[0].readings._replace(z_m=whole)
            mark_hidden(readings, view, constants, sight, layers.hidden)


def _within_both_ranges(settings: MapSettings, noise: DepthNoiseModel) -> DepthNoiseModel:
    range_min_m = max(noise.range_min_m, settings.range_min_m)
    range_max_m = min(noise.range_max_m, settings.range_max_m)
    if range_min_m >= range_max_m:
        raise MappingError(
            f"the settings map {settings.range_min_m} to {settings.range_max_m} m and noise model "
            f"{noise.name!r} covers {noise.range_min_m} to {noise.range_max_m} m; expected ranges "
            "that overlap"
        )
    return noise.with_range(range_min_m, range_max_m)


def _around(
    noise: DepthNoiseModel, settings: MapSettings, fallback: DepthNoiseModel | None
) -> list[DepthNoiseModel]:
    """Return the fallback for the distances below and above those that `noise` covers."""
    if fallback is None:
        return []
    wanted = _within_both_ranges(settings, fallback)
    # Readings are float32; the one at a bound belongs to `noise`.
    below = float(np.nextafter(np.float32(noise.range_min_m), np.float32(0.0)))
    above = float(np.nextafter(np.float32(noise.range_max_m), np.float32(np.inf)))
    parts = [(wanted.range_min_m, below), (above, wanted.range_max_m)]
    return [fallback.with_range(low, high) for low, high in parts if low < high]


def _together(parts: Sequence[FloatArray]) -> FloatArray:
    """Return the sum of what reducers of separate distances hold; that of one is not copied."""
    return parts[0] if len(parts) == 1 else np.sum(parts, axis=0, dtype=parts[0].dtype)
