"""Where a map has its origin: in the truth's frame, or where its rover stood at the start.

A map of motion capture is in the frame of the truth. One that a rover made with its own poses has
its origin, height and heading at its start, which says nothing about the map; held against the
truth as it is, a rover that stood 65 mm above the truth's zero is wrong by 65 mm everywhere. The
truth is then taken to the map's frame by the (x, y, z, yaw) of the start. Roll and pitch are not
forgiven: both frames have gravity.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Literal

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial.transform import Rotation

from drivers.depth.trajectory import Trajectory, interpolate
from mapping.cells.elevation_map import ElevationMap
from mapping.errors import MappingError
from mapping.judging.accuracy import Float64Array, Json
from mapping.judging.truth import Truth

OriginName = Literal["world", "start"]

_POSE_GAP_MAX_S = 0.5
# Less than this is rounding, and needs no resampling of the truth.
_NO_TURN_RAD = 1e-9


@dataclass(frozen=True, slots=True)
class Origin:
    """The map's frame in the truth's.

    Attributes:
        name: "world" for one and the same frame.
        x_m, y_m, z_m: origin of the map's frame.
        yaw_rad: its heading.
    """

    name: OriginName
    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.0
    yaw_rad: float = 0.0

    def as_json(self) -> Json:
        """Return the numbers by name."""
        return dict(asdict(self))

    def line(self) -> str:
        """Return it as a line of text."""
        if self.name == "world":
            return "origin: that of the truth"
        return (
            f"origin: relative to the start; the map begins at x {self.x_m:z.3f}, "
            f"y {self.y_m:z.3f}, z {self.z_m:z.3f} m, "
            f"heading {math.degrees(self.yaw_rad):z.2f} deg of the truth"
        )


def origin_name(map_: ElevationMap) -> OriginName:
    """Return where a map has its origin, by the poses that it says it was made with."""
    source = str(map_.attributes.get("setting_pose_source", ""))
    return "start" if source.startswith("ego-motion") else "world"


def start_origin(truth: Truth, believed: Trajectory | None) -> Origin:
    """Return the frame of a map that begins at the rover's start.

    Args:
        truth: has the true poses.
        believed: poses that the map was made with; when left out, the map begins where and when
            the true poses begin.

    Raises:
        MappingError: the truth has no poses, or none at a time of `believed`.
    """
    if truth.poses is None:
        raise MappingError(
            "the truth holds no poses, and the map begins where its rover stood; give the truth of "
            "a simulated run, or --origin world if the map is in the truth's frame"
        )
    if believed is None:
        return _origin(truth.poses.position_m[0], truth.poses.quat_xyzw[0], np.zeros(3), 0.0)
    position, quat_wxyz, known = interpolate(truth.poses, believed.t_ns, _POSE_GAP_MAX_S)
    if not known.any():
        raise MappingError(
            f"{believed.path} holds no pose at a time of the truth's; expected the same clock"
        )
    first = int(np.argmax(known))
    quat_xyzw = quat_wxyz[first][[1, 2, 3, 0]]
    yaw_rad = _yaw(believed.quat_xyzw[first])
    return _origin(position[first], quat_xyzw, believed.position_m[first], yaw_rad)


def in_frame_of(truth: Truth, origin: Origin) -> Truth:
    """Return the truth, poses included, in the frame of a map with that origin.

    A turned truth is resampled, bilinear, at half of its steps.
    """
    shift = np.array([origin.x_m, origin.y_m, origin.z_m])
    turn = Rotation.from_euler("z", -origin.yaw_rad)
    poses = truth.poses
    if poses is not None:
        poses = replace(
            poses,
            position_m=turn.apply(poses.position_m - shift),
            quat_xyzw=(turn * Rotation.from_quat(poses.quat_xyzw)).as_quat(),
        )
    height_m = truth.height_m - origin.z_m
    x_m, y_m = truth.x_m - origin.x_m, truth.y_m - origin.y_m
    shifted = Truth(x_m, y_m, height_m, truth.visible, poses)
    return shifted if abs(origin.yaw_rad) < _NO_TURN_RAD else _turned(shifted, origin.yaw_rad)


def _turned(truth: Truth, yaw_rad: float) -> Truth:
    """Return a truth's heights and visible points on axes that are turned by `yaw_rad`."""
    cosine, sine = math.cos(yaw_rad), math.sin(yaw_rad)
    corner_x, corner_y = np.meshgrid(truth.x_m[[0, -1]], truth.y_m[[0, -1]])
    x_m = _axis(cosine * corner_x + sine * corner_y, truth.x_m)
    y_m = _axis(cosine * corner_y - sine * corner_x, truth.y_m)
    x, y = np.meshgrid(x_m, y_m)
    places = np.stack([sine * x + cosine * y, cosine * x - sine * y], axis=-1)
    axes = (truth.y_m, truth.x_m)
    heights = RegularGridInterpolator(axes, truth.height_m, bounds_error=False)
    visible = None
    if truth.visible is not None:
        values = truth.visible.astype(np.float64)
        nearest = RegularGridInterpolator(
            axes, values, "nearest", bounds_error=False, fill_value=0.0
        )
        visible = nearest(places) > 0.5
    return Truth(x_m, y_m, heights(places), visible, truth.poses)


def _axis(corners_m: Float64Array, like_m: Float64Array) -> Float64Array:
    """Return grid points from the least to the largest corner at half the steps of an axis."""
    step = 0.5 * float(np.median(np.diff(like_m)))
    low, high = float(corners_m.min()), float(corners_m.max())
    return np.array([low + step * k for k in range(int((high - low) / step) + 1)])


def _origin(
    true_m: Float64Array, true_xyzw: Float64Array, believed_m: Float64Array, believed_rad: float
) -> Origin:
    """Return the frame in which a true pose is the believed one, both turned upright."""
    yaw_rad = math.remainder(_yaw(true_xyzw) - believed_rad, math.tau)
    shift = true_m - Rotation.from_euler("z", yaw_rad).apply(believed_m)
    x_m, y_m, z_m = shift.tolist()
    return Origin("start", x_m, y_m, z_m, yaw_rad)


def _yaw(quat_xyzw: Float64Array) -> float:
    """Return the heading of the body's x axis."""
    x, y, _ = Rotation.from_quat(quat_xyzw).as_matrix()[:, 0]
    return math.atan2(y, x)
