"""What the errors of poses and motions make of a map's variance when it is read out.

The equations are in `mapping.motion.pose_errors`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapping.cells.cell_layers import CellLayers
from mapping.motion.ledger import Motions, at_rest
from mapping.motion.pose_errors import ABSOLUTE, PoseErrorModel
from mapping.motion.read_out_kernels import PlaceErrors, PoseVariances, Stamps, add_errors

Float64Array = NDArray[np.float64]


class Rover(NamedTuple):
    """Where the rover is, how it came there, and what its poses are worth.

    x_m, y_m: place in T that distances are taken from.
    """

    x_m: float
    y_m: float
    motions: Motions
    pose_errors: PoseErrorModel


def standing(x_m: float = 0.0, y_m: float = 0.0) -> Rover:
    """Return a rover with absolute poses: nothing is added to the map's own variance."""
    return Rover(x_m, y_m, at_rest(), ABSOLUTE)


def place_errors(
    layers: CellLayers, x_m: Float64Array, y_m: Float64Array, rover: Rover
) -> PlaceErrors:
    """Return what motions and poses add to the cells at columns `x_m` and rows `y_m`."""
    model = rover.pose_errors
    shape = (y_m.size, x_m.size)
    out = PlaceErrors(*(np.empty(shape) for _ in PlaceErrors._fields))
    pose = PoseVariances(
        x_m=rover.x_m,
        y_m=rover.y_m,
        frame_m2=model.frame_sigma_m**2,
        frame_rad2=model.frame_sigma_rad**2,
        drift_per_m=model.drift_per_m,
        gravity_rad2=model.gravity_sigma_rad**2,
        place_m2=model.place_sigma_m**2,
        heading_rad2=model.heading_sigma_rad**2,
    )
    cells = Stamps(*(getattr(layers, name) for name in Stamps._fields))
    add_errors(cells, x_m, y_m, rover.motions, pose, out)
    return out
