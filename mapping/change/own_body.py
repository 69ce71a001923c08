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
def _farthest(c: Float64Array, origin_m: Float64Array, boxes_m: Float64Array) -> np.float32:
    """Return a distance along the optical axis beyond every corner of every box."""
    farthest = 0.0
    for k in range(boxes_m.shape[0]):
        corner = 0.0
        for axis in range(3):
            low = c[axis, 2] * (boxes_m[k, axis] - origin_m[axis])
            high = c[axis, 2] * (boxes_m[k, axis + 3] - origin_m[axis])
            corner += max(low, high)
        farthest = max(farthest, corner)
    return np.float32(farthest * 1.00001 + 1e-5)  # more than float32 rounds off


@njit(cache=True, error_model="numpy")
def _any_within(row: Float32Array, farthest: np.float32) -> bool:
    """Tell whether a row has a reading so near; no branch, so that it is vectorised."""
    found = np.int32(0)
    for u in range(row.size):
        found |= np.int32((row[u] > np.float32(0.0)) & (row[u] <= farthest))
    return bool(found > 0)


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
    farthest = _farthest(c, origin_m, boxes_m)
    for v in range(ray_y.shape[0]):
        row = z_m[v + margin]
        if not _any_within(row, farthest):
            continue
        y = float(ray_y[v])
        for u in range(ray_x.shape[0]):
            if row[u + margin] > farthest or row[u + margin] == 0.0:
                continue
            z, x = float(row[u + margin]), float(ray_x[u])
            rover_x = origin_m[0] + z * (c[0, 0] * x + c[0, 1] * y + c[0, 2])
            rover_y = origin_m[1] + z * (c[1, 0] * x + c[1, 1] * y + c[1, 2])
            rover_z = origin_m[2] + z * (c[2, 0] * x + c[2, 1] * y + c[2, 2])
            if _is_inside(boxes_m, rover_x, rover_y, rover_z):
                row[u + margin] = 0.0
                dropped += 1
    return dropped
