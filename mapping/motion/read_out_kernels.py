"""What motions and poses add to every cell (numba, cached, each cell on its own).

The equations are in `mapping.motion.pose_errors`; `mapping.motion.read_out` says what is what.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.motion.ledger import (
    SUM_M,
    SUM_XX,
    SUM_XY,
    SUM_XYAW,
    SUM_YAW,
    SUM_YY,
    SUM_YYAW,
    SUM_ZZ,
    Motions,
)

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]


class Stamps(NamedTuple):
    """The layers of `CellLayers` of these names that motions have to do with."""

    motion: NDArray[np.uint32]
    horizontal_xx_m2: Float32Array
    horizontal_xy_m2: Float32Array
    horizontal_yy_m2: Float32Array
    stale_m: Float32Array


class PoseVariances(NamedTuple):
    """The numbers of `PoseErrorModel`, squared but for the drift, and the rover's place."""

    x_m: float
    y_m: float
    frame_m2: float
    frame_rad2: float
    drift_per_m: float
    gravity_rad2: float
    place_m2: float
    heading_rad2: float


class PlaceErrors(NamedTuple):
    """What moving has done to cells; layers of the map's shape.

    height_m2: variance of the height that motions have added. pose_m2: V_frame + V_drift +
    V_gravity. xx_m2, xy_m2, yy_m2: covariance of the cells' places relative to the rover beyond
    what every cell has from the start.
    """

    height_m2: Float64Array
    pose_m2: Float64Array
    xx_m2: Float64Array
    xy_m2: Float64Array
    yy_m2: Float64Array


@njit(cache=True, error_model="numpy")
def add_errors(
    cells: Stamps,
    x_m: Float64Array,
    y_m: Float64Array,
    motions: Motions,
    pose: PoseVariances,
    out: PlaceErrors,
) -> None:
    """Fill `out` for the cells at columns `x_m` and rows `y_m`."""
    now = motions.sums[motions.now]
    for row in range(y_m.size):
        y, ahead = y_m[row] - motions.anchor_y_m, y_m[row] - pose.y_m
        for column in range(x_m.size):
            x, right = x_m[column] - motions.anchor_x_m, x_m[column] - pose.x_m
            since = motions.sums[min(int(cells.motion[row, column]), motions.now)]
            along_x, along_y = now[SUM_XYAW] - since[SUM_XYAW], now[SUM_YYAW] - since[SUM_YYAW]
            yaw = now[SUM_YAW] - since[SUM_YAW]
            xx = now[SUM_XX] - since[SUM_XX] - 2.0 * y * along_x + y * y * yaw
            yy = now[SUM_YY] - since[SUM_YY] + 2.0 * x * along_y + x * x * yaw
            xx = cells.horizontal_xx_m2[row, column] + max(xx, 0.0)
            yy = cells.horizontal_yy_m2[row, column] + max(yy, 0.0)
            xy = now[SUM_XY] - since[SUM_XY] + x * along_x - y * along_y - x * y * yaw
            limit = np.sqrt(xx * yy)
            xy = min(max(cells.horizontal_xy_m2[row, column] + xy, -limit), limit)
            driven_m = cells.stale_m[row, column] + (now[SUM_M] - since[SUM_M])
            drifted = 1.0 + pose.drift_per_m * driven_m
            distance2 = right * right + ahead * ahead
            out.height_m2[row, column] = now[SUM_ZZ] - since[SUM_ZZ]
            frame_m2 = (pose.frame_m2 + pose.frame_rad2 * distance2) * drifted
            out.pose_m2[row, column] = frame_m2 + pose.gravity_rad2 * distance2
            # place^2 I + heading^2 (e x r)(e x r)' with e x r = (-ahead, right).
            heading = pose.heading_rad2
            out.xx_m2[row, column] = xx + (pose.place_m2 + heading * ahead * ahead) * drifted
            out.xy_m2[row, column] = xy - heading * ahead * right * drifted
            out.yy_m2[row, column] = yy + (pose.place_m2 + heading * right * right) * drifted
