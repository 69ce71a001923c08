"""What connects the Jackal's bodies with the ground: soil forces, or MuJoCo's height field."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulation.terrain.height_grid import Float32Array, HeightGrid
from simulation.vehicle import jackal
from simulation.vehicle.soil import BODY_COLUMNS, Soil, plate_elements, press, rim_elements

Float64Array = NDArray[np.float64]
Int64Array = NDArray[np.int64]

_RIM_PARTS = (72, 3)


@njit(cache=True, nogil=True, error_model="numpy")
def _body_states(
    origin_m: Float64Array, matrix: Float64Array, qvel: Float64Array, states: Float64Array
) -> None:
    """Write the (5, 18) rows that `soil.press` takes; chassis first, then the wheels."""
    rate = np.empty(3)
    for k in range(3):
        rate[k] = np.sum(matrix[0, 3 * k : 3 * k + 3] * qvel[3:6])
    for b in range(states.shape[0]):
        states[b, 0:3] = origin_m[b]
        states[b, 3:12] = matrix[b]
        states[b, 12:15] = qvel[0:3] + np.cross(rate, origin_m[b] - origin_m[0])
        states[b, 15:18] = rate
        if b > 0:  # about the axle, which is the wheel's y axis
            for k in range(3):
                states[b, 15 + k] += qvel[5 + b] * matrix[b, 3 * k + 1]


@njit(cache=True, nogil=True, error_model="numpy")
def _apply(
    ground: tuple[Float32Array, float, float, float],
    soil: Float64Array,
    stiffness: Float64Array,
    grip: Float64Array,
    elements: Float64Array,
    first: Int64Array,
    slipped_m: Float64Array,
    states: Float64Array,
    centre_m: Float64Array,
    applied: Float64Array,
) -> None:
    """Write the ground's force and torque at each body's centre of mass, world axes."""
    for b in range(states.shape[0]):
        part = slice(first[b], first[b + 1])
        press(
            ground,
            soil,
            stiffness[b],
            grip[b],
            elements[part],
            slipped_m[part],
            states[b],
            jackal.STEP_S,
            applied[b],
        )
        applied[b, 3:6] -= np.cross(centre_m[b] - states[b, 0:3], applied[b, 0:3])


class SoilContact:
    """Presses a grid's soil against chassis and wheels.

    Args:
        grid: the ground.
        soil: its constants.
    """

    def __init__(self, grid: HeightGrid, soil: Soil) -> None:
        self._ground = (grid.height_m, grid.origin_x_m, grid.origin_y_m, grid.spacing_m)
        self._soil = soil.constants()
        widths = np.array([jackal.CHASSIS_SIZE_M[1]] + [jackal.WHEEL_WIDTH_M] * 4)
        self._stiffness = soil.k_c / widths + soil.k_phi
        bodies = [_chassis_elements()]
        bodies += [rim_elements(jackal.WHEEL_RADIUS_M, jackal.WHEEL_WIDTH_M, *_RIM_PARTS)] * 4
        self._elements = np.vstack(bodies)
        self._first = np.cumsum([0] + [len(body) for body in bodies]).astype(np.int64)
        self._slipped_m = np.zeros((len(self._elements), 2))
        self._states = np.zeros((5, BODY_COLUMNS))
        self._grip = np.ones(5)

    def reset(self) -> None:
        """Forget how far the surfaces have slipped."""
        self._slipped_m[:] = 0.0

    def apply(self, data: Any, wheel_grip: Float64Array) -> None:  # noqa: ANN401 - MjData is untyped
        """Write the forces at the positions and velocities of `data` into its `xfrc_applied`.

        Args:
            data: MuJoCo's state of the vehicle after `mj_step1`.
            wheel_grip: (4,) factor on the shear strength under each wheel.
        """
        self._grip[1:] = wheel_grip
        _body_states(data.xpos[1:], data.xmat[1:], data.qvel, self._states)
        _apply(
            self._ground,
            self._soil,
            self._stiffness,
            self._grip,
            self._elements,
            self._first,
            self._slipped_m,
            self._states,
            data.xipos[1:],
            data.xfrc_applied[1:],
        )


def _chassis_elements() -> Float64Array:
    """Return the elements of underside, front and rear of the chassis."""
    length, width, height = jackal.CHASSIS_SIZE_M
    x, z = length / 2.0, height / 2.0
    along, across, upwards = (length, 0.0, 0.0), (0.0, width, 0.0), (0.0, 0.0, height)
    return np.vstack(
        [
            plate_elements((0.0, 0.0, 0.0), across, along, (6, 8)),
            plate_elements((x, 0.0, z), across, upwards, (6, 4)),
            plate_elements((-x, 0.0, z), upwards, across, (4, 6)),
        ]
    )


def height_field(grid: HeightGrid) -> tuple[jackal.HeightField, Float64Array]:
    """Return MuJoCo's description of the ground and its (rows, columns) heights from 0 to 1."""
    x_min, x_max, y_min, y_max = grid.extent
    low, high = float(grid.height_m.min()), float(grid.height_m.max())
    relief_m = max(high - low, 1e-3)
    field = jackal.HeightField(
        shape=(grid.height_m.shape[0], grid.height_m.shape[1]),
        half_size_m=((x_max - x_min) / 2.0, (y_max - y_min) / 2.0),
        relief_m=relief_m,
        centre_m=((x_min + x_max) / 2.0, (y_min + y_max) / 2.0, low),
    )
    return field, (grid.height_m - np.float64(low)) / relief_m
