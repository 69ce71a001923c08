"""What the errors of poses and motions make of a map's variance when it is read out.

The equations are in `mapping.motion.pose_errors`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapping.cells.cell_layers import CellLayers
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
    at_rest,
)
from mapping.motion.pose_errors import ABSOLUTE, PoseErrorModel

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]


class Rover(NamedTuple):
    """Where the rover is, how it came there, and what its poses are worth.

    x_m, y_m: place in T that distances are taken from.
    """

    x_m: float
    y_m: float
    motions: Motions
    pose_errors: PoseErrorModel


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


def standing(x_m: float = 0.0, y_m: float = 0.0) -> Rover:
    """Return a rover with absolute poses: nothing is added to the map's own variance."""
    return Rover(x_m, y_m, at_rest(), ABSOLUTE)


def place_errors(
    layers: CellLayers, x_m: Float64Array, y_m: Float64Array, rover: Rover
) -> PlaceErrors:
    """Return what motions and poses add to the cells at columns `x_m` and rows `y_m`."""
    model = rover.pose_errors
    height_m2, xx, xy, yy, driven_m = _caught_up(layers, x_m, y_m[:, np.newaxis], rover.motions)
    right, ahead = x_m - rover.x_m, y_m[:, np.newaxis] - rover.y_m
    distance2 = right * right + ahead * ahead
    drifted = 1.0 + model.drift_per_m * driven_m
    pose_m2 = (model.frame_sigma_m**2 + model.frame_sigma_rad**2 * distance2) * drifted
    pose_m2 += model.gravity_sigma_rad**2 * distance2
    # place^2 I + heading^2 (e x r)(e x r)' with e x r = (-ahead, right).
    place, heading = model.place_sigma_m**2, model.heading_sigma_rad**2
    xx += (place + heading * ahead * ahead) * drifted
    xy -= heading * ahead * right * drifted
    yy += (place + heading * right * right) * drifted
    return PlaceErrors(height_m2, pose_m2, xx, xy, yy)


def _caught_up(
    layers: CellLayers, x_m: Float64Array, y_m: Float64Array, motions: Motions
) -> tuple[Float64Array, ...]:
    """Return height_m2, xx, xy, yy and metres driven of every cell, motions up to now included."""
    xx, xy, yy = (
        layer.astype(np.float64)
        for layer in (layers.horizontal_xx_m2, layers.horizontal_xy_m2, layers.horizontal_yy_m2)
    )
    driven_m = layers.stale_m.astype(np.float64)
    if motions.now == 0:
        return np.zeros_like(xx), xx, xy, yy, driven_m
    missed = motions.sums[motions.now] - motions.sums[np.minimum(layers.motion, motions.now)]
    x, y = x_m - motions.anchor_x_m, y_m - motions.anchor_y_m
    along_x, along_y, yaw = (missed[..., k] for k in (SUM_XYAW, SUM_YYAW, SUM_YAW))
    xx += np.maximum(missed[..., SUM_XX] - 2.0 * y * along_x + y * y * yaw, 0.0)
    xy += missed[..., SUM_XY] + x * along_x - y * along_y - x * y * yaw
    yy += np.maximum(missed[..., SUM_YY] + 2.0 * x * along_y + x * x * yaw, 0.0)
    limit = np.sqrt(xx * yy)
    return missed[..., SUM_ZZ], xx, np.clip(xy, -limit, limit), yy, driven_m + missed[..., SUM_M]
