"""A map from where the rover was: how far its cells were, and their heights in its true frame.

A map that is made with the rover's own poses drifts with them, and a rover that drives by the map
does not mind: to it, the map is wrong only by what differs between where a cell seems to be from
the believed pose and where the terrain is from the true one. With p a cell's point in the map and
T_believed, T_true the poses of the tracked body at one moment,

    q = T_true T_believed^-1 p,    error = q_z - truth(q_x, q_y)

With true poses q = p, and the errors are those in the world.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial.transform import Rotation

from drivers.depth.trajectory import Trajectory, interpolate
from mapping.cells.elevation_map import ElevationMap
from mapping.errors import MappingError
from mapping.judging.accuracy import BoolArray, Float64Array

Int64Array = NDArray[np.int64]

# Farther from the rover a height says more about the angles of the pose than about the map.
RELATIVE_RANGE_MAX_M = 3.0
RELATIVE_FRAMES_MIN, RELATIVE_PIXELS_MIN = 2, 4
_POSE_GAP_MAX_S = 0.5


@dataclass(frozen=True, slots=True)
class RoverTracks:
    """The poses of the tracked body at the same times, by the truth and by the map's maker.

    Attributes:
        true: in the terrain frame of the truth.
        believed: in the frame of the map; those that the map was made with.
    """

    true: Trajectory
    believed: Trajectory


class RelativeCells(NamedTuple):
    """Cells beside the truth in the rover's frame; (N,) arrays.

    Attributes:
        error_m: height minus truth.
        sigma_m: claimed for the height.
        slope_rad: of the truth, NaN where it is not known all around.
        range_m: horizontal distance from the rover.
        edge: the truth steps to one of four neighbours.
    """

    error_m: Float64Array
    sigma_m: Float64Array
    slope_rad: Float64Array
    range_m: Float64Array
    edge: BoolArray


def seen_from_m(map_: ElevationMap, believed: Trajectory) -> Float64Array:
    """Return each cell's range, shape of the map's layers; NaN where no pose is known.

    The range of a cell is its horizontal distance from the tracked body at the moment when the
    cell was last seen.
    """
    position, _, known = _poses_at(believed, map_.last_seen_ns.ravel())
    x_m, y_m = np.meshgrid(map_.x_m, map_.y_m)
    range_m = np.hypot(x_m.ravel() - position[:, 0], y_m.ravel() - position[:, 1])
    return np.where(known & map_.known.ravel(), range_m, np.nan).reshape(map_.state.shape)


def relative_cells(
    map_: ElevationMap,
    cells: BoolArray,
    truth: RegularGridInterpolator,
    tracks: RoverTracks,
    t_ns: Int64Array,
    edge_step_m: float,
) -> RelativeCells:
    """Return cells as errors in the rover's frame.

    Cells count when the rover was within 3 m of them and they have two frames and four pixels.

    Args:
        map_: the map.
        cells: those that may count, shape of the map's layers.
        truth: true height at (..., 2) places (y, x), NaN = not known.
        tracks: both trajectories.
        t_ns: the moment for each cell, shape of the map's layers.
        edge_step_m: see `mapping.judging.evaluation.evaluate`.
    """
    cells = cells & (map_.frames >= RELATIVE_FRAMES_MIN) & (map_.pixels >= RELATIVE_PIXELS_MIN)
    rows, columns = np.nonzero(cells)
    point = np.column_stack([map_.x_m[columns], map_.y_m[rows], map_.elevation_m[cells]])
    believed_m, believed, known = _poses_at(tracks.believed, t_ns[cells])
    true_m, true, known_too = _poses_at(tracks.true, t_ns[cells])
    range_m = np.hypot(*(point - believed_m)[:, :2].T)
    point = true_m + true.apply(believed.inv().apply(point - believed_m))
    height, around = _surroundings(truth, point[:, :2], map_.resolution_m)
    use = known & known_too & (range_m <= RELATIVE_RANGE_MAX_M) & np.isfinite(height)
    gradient = (around[:, 1] - around[:, 0]) / (2.0 * map_.resolution_m)
    return RelativeCells(
        (point[:, 2] - height)[use],
        map_.sigma_m[cells].astype(np.float64)[use],
        np.arctan(np.hypot(*gradient))[use],
        range_m[use],
        np.any(np.abs(around - height) > edge_step_m, axis=(0, 1))[use],
    )


def check_overlap(map_: ElevationMap, believed: Trajectory) -> None:
    """Raise MappingError unless the trajectory knows where the rover was for some of the cells."""
    if not _poses_at(believed, map_.last_seen_ns[map_.known])[2].any():
        raise MappingError(
            f"{believed.path} holds no pose at a time of the map; expected the poses that the map "
            "was made with, on the recording's clock in seconds"
        )


def _poses_at(trajectory: Trajectory, t_ns: Int64Array) -> tuple[Float64Array, Rotation, BoolArray]:
    """Return (N, 3) positions, N rotations and (N,) which are known; the others are no motion."""
    times, which = np.unique(t_ns, return_inverse=True)
    position, quat_wxyz, known = interpolate(trajectory, times, _POSE_GAP_MAX_S)
    position[~known] = 0.0
    quat_wxyz[~known] = (1.0, 0.0, 0.0, 0.0)
    rotation = Rotation.from_quat(quat_wxyz[which], scalar_first=True)
    return position[which], rotation, known[which]


def _surroundings(
    truth: RegularGridInterpolator, xy_m: Float64Array, distance_m: float
) -> tuple[Float64Array, Float64Array]:
    """Return (N,) heights, and (2, 2, N): before and after along x, before and after along y."""
    here = xy_m[:, ::-1]
    steps = distance_m * np.array([[[0.0, -1.0], [0.0, 1.0]], [[-1.0, 0.0], [1.0, 0.0]]])
    return truth(here), truth(here + steps[:, :, np.newaxis])
