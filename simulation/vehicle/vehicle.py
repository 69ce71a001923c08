"""The vehicle on its ground, in steps of one millisecond.

MuJoCo moves the bodies; in the contact "soil" the ground's forces on wheels and chassis come from
`simulation.vehicle.soil`, in the contact "native" from MuJoCo's own height field.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from simulation.errors import SimulationError
from simulation.terrain.height_grid import HeightGrid
from simulation.vehicle import jackal
from simulation.vehicle.ground_contact import SoilContact, height_field
from simulation.vehicle.soil import Soil

Float64Array = NDArray[np.float64]
Contact = Literal["soil", "native"]

STEPS_PER_MS = round(1e-3 / jackal.STEP_S)
_LONGEST_SETTLING_MS = 4000
_SETTLED = 1e-4  # m/s and rad/s, of every joint
_SINKAGE_M = 0.015  # about what the wheels' load makes; only a start for settling
# A wheel's commanded angle leads its true one by what gives the full torque, and no more.
_MAX_LEAD_RAD = jackal.MOTOR_TORQUE_NM / jackal.MOTOR_STIFFNESS


@dataclass(frozen=True, slots=True)
class Disturbance:
    """What acts on the vehicle besides ground and gravity.

    Attributes:
        grip: (4,) factor on the soil's shear strength, or the friction, under each wheel.
        force_n: (3,) on the chassis' centre of mass, world axes.
    """

    grip: Float64Array = field(default_factory=lambda: np.ones(4))
    force_n: Float64Array = field(default_factory=lambda: np.zeros(3))


class Vehicle:
    """A Jackal standing still on the ground.

    Args:
        grid: the ground.
        contact: "soil", or "native" for MuJoCo's height field (hard ground).
        soil: constants of the soil; not used by "native".
        gravity_m_s2: downwards.
        accelerometer_m: place of the accelerometer in frame R.

    Attributes:
        acceleration_m_s2: (3,) specific force at the accelerometer in R's axes, mean over the
            last millisecond.
    """

    def __init__(
        self,
        grid: HeightGrid,
        contact: Contact = "soil",
        soil: Soil | None = None,
        gravity_m_s2: float = 9.80665,
        accelerometer_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        self._grid = grid
        self._soil_contact = SoilContact(grid, soil or Soil()) if contact == "soil" else None
        field, heights = (None, None) if self._soil_contact else height_field(grid)
        text = jackal.model_xml(gravity_m_s2, accelerometer_m, field)
        self._model = mujoco.MjModel.from_xml_string(text)
        if heights is not None:
            self._model.hfield_data[:] = heights.ravel()
        self._data = mujoco.MjData(self._model)
        axles = [self._model.joint(f"axle{i}") for i in range(4)]
        self._axle_q = np.array([axle.qposadr[0] for axle in axles])
        self._axle_v = np.array([axle.dofadr[0] for axle in axles])
        self._tyres = (
            [] if self._soil_contact else [self._model.geom(f"tyre{i}").id for i in range(4)]
        )
        self._target_rad = np.zeros(4)
        self.acceleration_m_s2 = np.zeros(3)

    @property
    def mass_kg(self) -> float:
        """Return the mass of chassis and wheels together."""
        return float(self._model.body_mass.sum())

    @property
    def position_m(self) -> Float64Array:
        """Return the (3,) origin of R in the world."""
        return np.array(self._data.qpos[:3])

    @property
    def quat_wxyz(self) -> Float64Array:
        """Return the (4,) rotation from R to the world."""
        return np.array(self._data.qpos[3:7])

    @property
    def velocity_m_s(self) -> Float64Array:
        """Return the (3,) velocity of R's origin, world axes."""
        return np.array(self._data.qvel[:3])

    @property
    def body_rate_rad_s(self) -> Float64Array:
        """Return the (3,) angular velocity in R's axes."""
        return np.array(self._data.qvel[3:6])

    @property
    def wheel_rate_rad_s(self) -> Float64Array:
        """Return the (4,) rates of the wheels against the chassis, positive forwards."""
        return np.array(self._data.qvel[self._axle_v])

    def place(self, x_m: float, y_m: float, yaw_rad: float) -> None:
        """Set the vehicle on the ground there, and let it come to rest.

        Raises:
            SimulationError: there is no ground under a wheel.
        """
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:3], self._data.qpos[3:7] = self._stance(x_m, y_m, yaw_rad)
        self._target_rad[:] = 0.0
        if self._soil_contact:
            self._soil_contact.reset()
        for _ in range(_LONGEST_SETTLING_MS):
            self.advance(np.zeros(4), Disturbance())
            if np.abs(self._data.qvel).max() < _SETTLED:
                break

    def advance(self, wheel_rate_rad_s: Float64Array, disturbance: Disturbance) -> None:
        """Move on by one millisecond with these (4,) commanded wheel rates.

        Raises:
            SimulationError: the vehicle left the ground's edge, or fell over.
        """
        turned = self._data.qpos[self._axle_q]
        self._target_rad += 1e-3 * wheel_rate_rad_s
        np.clip(self._target_rad, turned - _MAX_LEAD_RAD, turned + _MAX_LEAD_RAD, self._target_rad)
        self._data.ctrl[:] = (
            jackal.MOTOR_STIFFNESS * self._target_rad + jackal.MOTOR_DAMPING * wheel_rate_rad_s
        )
        total = np.zeros(3)
        for _ in range(STEPS_PER_MS):
            mujoco.mj_step1(self._model, self._data)
            self._push(disturbance)
            mujoco.mj_step2(self._model, self._data)
            total += self._data.sensordata
        self.acceleration_m_s2 = total / STEPS_PER_MS
        self._check()

    def _push(self, disturbance: Disturbance) -> None:
        applied = self._data.xfrc_applied
        applied[:] = 0.0
        if self._soil_contact:
            self._soil_contact.apply(self._data, disturbance.grip)
        else:
            self._model.geom_friction[self._tyres, 0] = jackal.TYRE_FRICTION * disturbance.grip
        applied[1, :3] += disturbance.force_n

    def _stance(self, x_m: float, y_m: float, yaw_rad: float) -> tuple[Float64Array, Float64Array]:
        """Return position and quaternion on the plane through the ground under the wheels."""
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        centres = np.array(jackal.WHEEL_CENTRES_M)
        x = x_m + cos * centres[:, 0] - sin * centres[:, 1]
        y = y_m + sin * centres[:, 0] + cos * centres[:, 1]
        ground = self._grid.height_at(x, y)
        if np.isnan(ground).any():
            raise SimulationError(
                f"no ground under the wheels at ({x_m:g}, {y_m:g}) m; "
                f"it covers {_extent_text(self._grid)}, start well inside"
            )
        plane = np.column_stack([x - x_m, y - y_m, np.ones(4)])
        (slope_x, slope_y, height), *_ = np.linalg.lstsq(plane, ground, rcond=None)
        up = np.array([-slope_x, -slope_y, 1.0]) / np.sqrt(1.0 + slope_x**2 + slope_y**2)
        left = np.cross(up, [cos, sin, 0.0])
        left /= np.linalg.norm(left)
        matrix = np.column_stack([np.cross(left, up), left, up])
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, matrix.ravel())
        above = (
            jackal.WHEEL_RADIUS_M - jackal.WHEEL_Z_M - (_SINKAGE_M if self._soil_contact else 0.0)
        )
        bump = float(np.max(ground - plane @ [slope_x, slope_y, height]))
        return np.array([x_m, y_m, height]) + (above + bump) * up, quat

    def _check(self) -> None:
        x, y, z = self._data.qpos[:3]
        x_min, x_max, y_min, y_max = self._grid.extent
        reach = jackal.CHASSIS_SIZE_M[0] / 2.0 + jackal.WHEEL_RADIUS_M
        if not (x_min + reach < x < x_max - reach and y_min + reach < y < y_max - reach):
            raise SimulationError(
                f"the vehicle reached the ground's edge at ({x:.2f}, {y:.2f}) m; it covers "
                f"{_extent_text(self._grid)}: shorten the drive or enlarge the ground"
            )
        if self._data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
            raise SimulationError(
                f"the vehicle's motion could not be solved near ({x:.2f}, {y:.2f}) m; "
                "choose gentler faults or smoother ground"
            )
        if self._data.xmat[1, 8] < 0.0:
            raise SimulationError(
                f"the vehicle fell over at ({x:.2f}, {y:.2f}, {z:.2f}) m; "
                "choose another start, a lower speed or smoother ground"
            )


def _extent_text(grid: HeightGrid) -> str:
    x_min, x_max, y_min, y_max = grid.extent
    return f"x {x_min:g} to {x_max:g} m, y {y_min:g} to {y_max:g} m"
