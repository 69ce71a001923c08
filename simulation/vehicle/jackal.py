"""The Clearpath Jackal as MuJoCo bodies: masses, inertias and geometry of its published model.

Body frame R: x forward, y left, z up; origin in the middle between the wheels at the level of the
chassis' underside. Wheels are numbered front left, rear left, front right, rear right.
"""

from __future__ import annotations

from dataclasses import dataclass

CHASSIS_KG = 16.523
WHEEL_KG = 0.477
CHASSIS_CENTRE_M = (0.012, 0.002, 0.067)
CHASSIS_INERTIA_KG_M2 = (0.3136, 0.3922, 0.4485)
WHEEL_INERTIA_KG_M2 = (0.0013, 0.0024, 0.0013)
CHASSIS_SIZE_M = (0.420, 0.310, 0.184)
WHEEL_RADIUS_M = 0.098
WHEEL_WIDTH_M = 0.040
WHEELBASE_M = 0.262
TRACK_M = 0.37559
WHEEL_Z_M = 0.0345
MAX_SPEED_M_S = 2.0
MAX_YAW_RATE_RAD_S = 4.0
# By this the base's own controller turns yaw rates into wheel speeds.
EFFECTIVE_TRACK_M = 1.5 * TRACK_M

# Everything is integrated explicitly (semi-implicit Euler, damping included), so that the
# accelerometer reads what the velocity does; with implicit damping they correlate to 0.93 on
# tyres. The stiffest part, a wheel on its tyre, has step * damping / mass = 0.31, far below 2.
STEP_S = 0.0005
# Speed controller of a wheel: holds the integral of the commanded speed, so that it neither
# creeps at rest nor lags under load. Nm/rad, Nm s/rad, Nm; ours, the base's are not published.
MOTOR_STIFFNESS = 40.0
MOTOR_DAMPING = 1.0
MOTOR_TORQUE_NM = 10.0

WHEEL_CENTRES_M = tuple(
    (side_x * WHEELBASE_M / 2.0, side_y * TRACK_M / 2.0, WHEEL_Z_M)
    for side_y in (1.0, -1.0)
    for side_x in (1.0, -1.0)
)

# Tyres of the native contact: N/m and N s/m along z and y.
_TYRE_JOINTS = (
    '<joint type="slide" axis="0 0 1" stiffness="30000" damping="300"/>'
    '<joint type="slide" axis="0 1 0" stiffness="15000" damping="150"/>'
)
# MuJoCo takes the larger friction of two bodies; the ground has none of its own.
TYRE_FRICTION = 0.75
_CHASSIS_FRICTION = 0.5
_NATIVE_OPTION = 'cone="elliptic" impratio="15" noslip_iterations="5"'


@dataclass(frozen=True, slots=True)
class HeightField:
    """Place and size of MuJoCo's height field.

    Attributes:
        shape: rows (along y) and columns (along x).
        half_size_m: half the length along x and y.
        relief_m: height of the highest point above the lowest.
        centre_m: middle in x and y, height of the lowest point.
    """

    shape: tuple[int, int]
    half_size_m: tuple[float, float]
    relief_m: float
    centre_m: tuple[float, float, float]


def model_xml(
    gravity_m_s2: float,
    accelerometer_m: tuple[float, float, float],
    field: HeightField | None = None,
) -> str:
    """Return the MJCF text of vehicle and world.

    Args:
        gravity_m_s2: downwards.
        accelerometer_m: place of the accelerometer in frame R.
        field: the ground, for a vehicle on tyres with MuJoCo's contact; None leaves contact to
            the forces that are applied from outside.
    """
    native = field is not None
    asset, ground = _field_xml(field) if field else ("", "")
    return f"""
<mujoco>
  <option timestep="{STEP_S}" gravity="0 0 {-gravity_m_s2}" {_NATIVE_OPTION if native else ""}>
    <flag eulerdamp="disable"/>
  </option>
  {asset}
  <worldbody>
    {ground}
    <body name="chassis">
      <freejoint/>
      <inertial pos="{_text(*CHASSIS_CENTRE_M)}" mass="{CHASSIS_KG}"
        diaginertia="{_text(*CHASSIS_INERTIA_KG_M2)}"/>
      {_chassis_geom() if native else ""}
      <site name="accelerometer" pos="{_text(*accelerometer_m)}"/>
      {"".join(_wheel(i, native) for i in range(4))}
    </body>
  </worldbody>
  <actuator>{"".join(map(_motor, range(4)))}</actuator>
  <sensor><accelerometer site="accelerometer"/></sensor>
</mujoco>"""


def _text(*values: float) -> str:
    return " ".join(repr(float(value)) for value in values)


def _field_xml(field: HeightField) -> tuple[str, str]:
    """Return the asset and the geometry; a metre of ground lies below the lowest point."""
    asset = (
        f'<asset><hfield name="ground" nrow="{field.shape[0]}" ncol="{field.shape[1]}" '
        f'size="{_text(*field.half_size_m, field.relief_m, 1.0)}"/></asset>'
    )
    geom = (
        f'<geom type="hfield" hfield="ground" pos="{_text(*field.centre_m)}" contype="1" '
        'conaffinity="0" friction="0 0 0"/>'
    )
    return asset, geom


def _chassis_geom() -> str:
    half = [side / 2.0 for side in CHASSIS_SIZE_M]
    return (
        f'<geom type="box" size="{_text(*half)}" pos="{_text(0.0, 0.0, half[2])}" mass="0" '
        f'contype="0" conaffinity="1" friction="{_CHASSIS_FRICTION} 0 0"/>'
    )


def _wheel(index: int, native: bool) -> str:
    return f"""
      <body name="wheel{index}" pos="{_text(*WHEEL_CENTRES_M[index])}">
        {_TYRE_JOINTS if native else ""}
        <joint name="axle{index}" type="hinge" axis="0 1 0"/>
        <inertial pos="0 0 0" mass="{WHEEL_KG}" diaginertia="{_text(*WHEEL_INERTIA_KG_M2)}"/>
        {_tyre(index) if native else ""}
      </body>"""


def _tyre(index: int) -> str:
    return (
        f'<geom name="tyre{index}" type="cylinder" zaxis="0 1 0" '
        f'size="{_text(WHEEL_RADIUS_M, WHEEL_WIDTH_M / 2.0)}" mass="0" contype="0" '
        f'conaffinity="1" condim="3" friction="{TYRE_FRICTION} 0 0"/>'
    )


def _motor(index: int) -> str:
    return (
        f'<general joint="axle{index}" gainprm="1" biastype="affine" '
        f'biasprm="0 {-MOTOR_STIFFNESS} {-MOTOR_DAMPING}" '
        f'forcelimited="true" forcerange="{-MOTOR_TORQUE_NM} {MOTOR_TORQUE_NM}"/>'
    )
