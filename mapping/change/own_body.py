"""The rover's own body in its camera's view: readings inside given boxes are dropped."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.geometry import RigidTransform
from mapping.measurement import Readings

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]


def drop_own_body(
    readings: Readings, boxes_m: Sequence[Sequence[float]], mount: RigidTransform
) -> int:
    """Drop the readings inside any box; return how many.

    Args:
        readings: a loaded frame, in the sensor's optical frame; changed in place.
        boxes_m: (x_min, y_min, z_min, x_max, y_max, z_max) in the rover frame, borders included.
        mount: the sensor's optical frame in the rover frame.
    """
    return int(
        drop_readings(
            readings.z_m,
            readings.margin_px,
            readings.ray_x,
            readings.ray_y,
            np.ascontiguousarray(mount.rotation),
            mount.translation_m,
            np.array(boxes_m, np.float64).reshape(-1, 6),
        )
    )


@njit(inline="always")
def _is_inside(boxes: Float64Array, x: float, y: float, z: float) -> bool:
    inside = False
    for k in range(boxes.shape[0]):
        inside |= (
            (x >= boxes[k, 0])
            & (y >= boxes[k, 1])
            & (z >= boxes[k, 2])
            & (x <= boxes[k, 3])
            & (y <= boxes[k, 4])
            & (z <= boxes[k, 5])
        )
    return inside


@njit(cache=True, error_model="numpy")
def drop_readings(
    z_m: Float32Array,
    margin: int,
    ray_x: Float32Array,
    ray_y: Float32Array,
    c: Float64Array,
    origin_m: Float64Array,
    boxes_m: Float64Array,
) -> int:
    """Zero the readings inside a box; c = C_RS, origin_m = the sensor in the rover frame."""
    dropped = 0
    for v in range(ray_y.shape[0]):
        y = float(ray_y[v])
        for u in range(ray_x.shape[0]):
            z = float(z_m[v + margin, u + margin])
            if z == 0.0:
                continue
            x = float(ray_x[u])
            rover_x = origin_m[0] + z * (c[0, 0] * x + c[0, 1] * y + c[0, 2])
            rover_y = origin_m[1] + z * (c[1, 0] * x + c[1, 1] * y + c[1, 2])
            rover_z = origin_m[2] + z * (c[2, 0] * x + c[2, 1] * y + c[2, 2])
            if _is_inside(boxes_m, rover_x, rover_y, rover_z):
                z_m[v + margin, u + margin] = 0.0
                dropped += 1
    return dropped
