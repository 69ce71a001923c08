"""The ego-motion of the 2019 paper, equations 36-55, as printed: for comparison, not for use.

Where the print contradicts itself, the smallest reading is taken: the C in front of scalars (38,
39, 47) is 1; 51 equals 49, for 50 solves 44 for the very Omega that 49 needs; 53 has no [e]x. The
"angular acceleration" beta of a single-axis gyro is the change of its rate over the interval, or,
by `beta_is_rate`, the rate itself, as the text says that the gyro's output be beta.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mapping.errors import MappingError
from mapping.geometry import Float64Array

WARNING = (
    "paper2019 cannot find the way: equations 36-41 have no velocity state, so that the sum of "
    "3/2 a dt^2 is 3/2 dt times the present speed, not the distance: 0.45 mm at 0.3 m/s and "
    "1 kHz, and 0 after a drive from stop to stop (3.1 m driven, 3.1 m wrong); its covariance "
    "(42) forgets the yaw"
)
_SHARE = 1.5


@dataclass(frozen=True, slots=True)
class PaperState:
    """Pose of the upright body R~ and its covariance.

    Attributes:
        position_m: (3,) r in the fixed frame I.
        yaw_rad: psi.
        covariance: (4, 4) of (x, y, z, yaw), eq. 44.
    """

    position_m: Float64Array
    yaw_rad: float
    covariance: Float64Array


@dataclass(frozen=True, slots=True)
class PaperStep:
    """One interval.

    Attributes:
        state: at its end.
        relative_covariance: (4, 4) of the motion in it, eq. 49 (= 51).
        position_covariance: (3, 3) its block Sigma_r of eq. 54.
        rotation_covariance: (3, 3) Sigma_Phi of eq. 55, J_psi = e_z.
    """

    state: PaperState
    relative_covariance: Float64Array
    position_covariance: Float64Array
    rotation_covariance: Float64Array


def paper_start() -> PaperState:
    """Return the pose at the start, known exactly."""
    return PaperState(np.zeros(3), 0.0, np.zeros((4, 4)))


def paper_step(
    state: PaperState,
    acceleration_m_s2: Float64Array,
    beta: float,
    dt_s: float,
    noise: Float64Array,
) -> PaperStep:
    """Move by one interval, as printed.

    Args:
        state: at its beginning.
        acceleration_m_s2: (3,) a of eq. 36 in R~, without gravity.
        beta: of eq. 38, rad/s^2 (or rad/s, see the module).
        dt_s: length of the interval.
        noise: (4, 4) Omega of eq. 44, of a and beta.

    Raises:
        MappingError: the interval is not above 0.
    """
    if not 0.0 < dt_s < math.inf:
        raise MappingError(f"an interval of {dt_s} s; expected more than 0")
    square = _SHARE * dt_s**2
    turned = _about_z(state.yaw_rad)
    way = square * turned @ acceleration_m_s2  # 37
    turn = square * beta  # 39
    j_x = np.eye(4)  # 42
    j_x[:3, 3], j_x[3, 3] = way, turn
    j_n = square * np.eye(4)  # 43
    j_n[:3, :3] = square * turned
    after = j_x @ state.covariance @ j_x.T + j_n @ noise @ j_n.T  # 44
    relative = noise * square**2  # 49
    rotation = np.zeros((3, 3))
    rotation[2, 2] = relative[3, 3]  # 55
    new = PaperState(state.position_m + way, state.yaw_rad + turn, after)  # 40, 41
    return PaperStep(new, relative, relative[:3, :3], rotation)


def paper_omega(before: PaperState, after: PaperState, dt_s: float) -> Float64Array:
    """Return Omega by eq. 50 with 52 and 53: what 51 puts where 49 has Omega.

    With the printed 53, whose Jacobian has way and turn of the interval, it is the Omega that
    44 was given: 51 says nothing that 49 does not.
    """
    way, turn = after.position_m - before.position_m, after.yaw_rad - before.yaw_rad
    j_x = np.eye(4)
    j_x[:3, 3], j_x[3, 3] = way, turn
    inverse = np.eye(4) / (_SHARE * dt_s**2)
    inverse[:3, :3] = _about_z(before.yaw_rad).T / (_SHARE * dt_s**2)  # 52
    middle = after.covariance - j_x @ before.covariance @ j_x.T
    return np.asarray(inverse @ middle @ inverse.T, np.float64)


def paper_path(
    acceleration_m_s2: Float64Array,
    rate_rad_s: Float64Array,
    dt_s: float,
    noise: Float64Array,
    *,
    beta_is_rate: bool = False,
) -> PaperState:
    """Return the pose after N intervals.

    Args:
        acceleration_m_s2: (N, 3) without gravity.
        rate_rad_s: (N + 1,) of the gyro at the ends of the intervals.
        dt_s, noise: as `paper_step`.
        beta_is_rate: take the rate itself for beta, not its change over the interval.
    """
    change = np.diff(rate_rad_s) / dt_s
    beta = rate_rad_s[:-1] if beta_is_rate else change
    state = paper_start()
    for a, b in zip(acceleration_m_s2, beta.tolist(), strict=True):
        state = paper_step(state, a, b, dt_s, noise).state
    return state


def _about_z(yaw_rad: float) -> Float64Array:
    """Return C_IR~."""
    s, c = math.sin(yaw_rad), math.cos(yaw_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
