"""A frame measured in plain numpy: the yardstick of `benchmarks/mapping.py`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.samples import CameraIntrinsics
from mapping.measurement import View

Float64Array = NDArray[np.float64]


def numpy_frame(
    depth_mm: NDArray[np.uint16], camera: CameraIntrinsics, cell_m: float, view: View
) -> Float64Array:
    """Height, variance with incidence angle and sums per cell, as one would write it in numpy."""
    z = depth_mm * 1e-3
    v, u = np.nonzero((z > 0.4) & (z < 4.0))
    slope_y, slope_x = (g[v, u] for g in np.gradient(z))
    z = z[v, u]
    ray = np.stack(
        [(u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px, np.ones_like(z)]
    )
    a, b = camera.fx_px * slope_x, camera.fy_px * slope_y
    normal = np.sqrt(a**2 + b**2 + (z + ray[0] * a + ray[1] * b) ** 2)
    length = np.sqrt((ray**2).sum(axis=0))
    theta = np.minimum(np.arccos(np.clip(z / (normal * length), 0.0, 1.0)), 1.466)
    ratio = theta / (np.pi / 2 - theta)
    sigma = 0.0012 + 0.0019 * (z - 0.4) ** 2 + 0.0001 / np.sqrt(z) * ratio**2
    lateral = (0.8 + 0.035 * ratio) * z / 580.0
    direction = view.T_terrain_sensor.rotation @ ray
    variance = (sigma * direction[2]) ** 2 + lateral**2 * (1 - (direction[2] / length) ** 2)
    x, y = z * direction[:2] + view.T_terrain_sensor.translation_m[:2, np.newaxis]
    column, row = np.floor(x / cell_m).astype(int), np.floor(y / cell_m).astype(int)
    column -= column.min()
    row -= row.min()
    index = row * (column.max() + 1) + column
    height, weight = z * direction[2], 1.0 / variance
    return np.stack([np.bincount(index, w) for w in (weight, weight * height, weight * height**2)])
