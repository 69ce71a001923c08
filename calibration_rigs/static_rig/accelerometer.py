"""Scale, bias and crookedness of an accelerometer from rest in several attitudes.

Whatever the attitude, the specific force at rest has the length of gravity. With a reading m (3,),
the calibrated force is f = T diag(1/s) (m - b), T the upper triangle with ones on its diagonal
that straightens the axes (Tedaldi, Pretto, Menegatti: A robust and easy to implement method for
IMU calibration without external equipments, ICRA 2014). s, b, T are those for which |f| = g.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from calibration_rigs.errors import RigError
from calibration_rigs.static_rig.rest import Stretch

Float64Array = NDArray[np.float64]

STANDARD_GRAVITY_M_S2 = 9.80665
_FEWEST_POSES = 6
_POSES_FOR_CROOKED_AXES = 9
# The weakest direction of the attitudes' spread: below this they show one side of the sensor.
_LEAST_SPREAD = 0.15


@dataclass(frozen=True, slots=True)
class AccelerometerCalibration:
    """What turns readings into specific force; units of the reading are called u.

    Attributes:
        scale: (3,) u / (m/s^2), and scale_sigma.
        bias: (3,) u, and bias_sigma.
        crooked_rad: (3,) angles yz, zy, zx by which the axes deviate from right angles: the
            entries -T(0, 1), T(0, 2), -T(1, 2); 0 with fewer than nine attitudes.
        residual_m_s2: root mean square of | |f| - g | over the attitudes.
        poses: how many attitudes.
    """

    scale: Float64Array
    scale_sigma: Float64Array
    bias: Float64Array
    bias_sigma: Float64Array
    crooked_rad: Float64Array
    residual_m_s2: float
    poses: int

    def force_m_s2(self, readings: Float64Array) -> Float64Array:
        """Return the specific force of readings (n, 3) in m/s^2, axes at right angles."""
        parameters = np.concatenate([self.scale, self.bias, self.crooked_rad])
        return _force(parameters, readings)


def mean_readings(readings: Float64Array, stretches: Sequence[Stretch]) -> Float64Array:
    """Return the mean reading of each stretch of rest, (len(stretches), 3)."""
    return np.array([readings[s.first : s.end].mean(axis=0) for s in stretches])


def calibrate_accelerometer(
    poses: Float64Array, gravity_m_s2: float = STANDARD_GRAVITY_M_S2
) -> AccelerometerCalibration:
    """Return the calibration from mean readings at rest (n, 3) in n attitudes.

    Six to eight attitudes give scale and bias, nine or more the axes' angles too. Sigmas follow
    from the misfit of the attitudes; infinite where these are no more than the unknowns.

    Raises:
        RigError: fewer than six attitudes, or all of them to one side.
    """
    _require_spread(poses)
    start = _start(poses, gravity_m_s2)
    unit = np.concatenate([start[:3], np.full(3, gravity_m_s2 * start[0]), np.ones(3)])
    unknowns = 9 if len(poses) >= _POSES_FOR_CROOKED_AXES else 6

    def misfit(scaled: Float64Array) -> Float64Array:
        """Return how far the length of each calibrated force is from gravity, m/s^2."""
        force = _force(_complete(scaled) * unit, poses)
        return np.asarray(np.linalg.norm(force, axis=1) - gravity_m_s2)

    first = (start / unit)[:unknowns]
    best = least_squares(misfit, first, method="lm", xtol=1e-14, ftol=1e-14)
    parameters = _complete(best.x) * unit
    freedom = len(poses) - unknowns
    variance = 2.0 * best.cost / freedom if freedom else np.inf
    sigma = np.sqrt(np.diag(np.linalg.pinv(best.jac.T @ best.jac)) * variance) * unit[:unknowns]
    return AccelerometerCalibration(
        scale=parameters[:3],
        scale_sigma=sigma[:3],
        bias=parameters[3:6],
        bias_sigma=sigma[3:6],
        crooked_rad=parameters[6:],
        residual_m_s2=float(np.sqrt(2.0 * best.cost / len(poses))),
        poses=len(poses),
    )


def _complete(found: Float64Array) -> Float64Array:
    return np.concatenate([found, np.zeros(9 - len(found))])


def _force(parameters: Float64Array, readings: Float64Array) -> Float64Array:
    scale, bias, crooked = parameters[:3], parameters[3:6], parameters[6:]
    straight = np.array([[1.0, -crooked[0], crooked[1]], [0.0, 1.0, -crooked[2]], [0.0, 0.0, 1.0]])
    return np.asarray(((readings - bias) / scale) @ straight.T)


def _start(poses: Float64Array, gravity_m_s2: float) -> Float64Array:
    """Return a first guess: the sphere |m - b| = s g that fits best, linear in b."""
    middle = poses.mean(axis=0)
    shifted = poses - middle
    lhs = np.hstack([2.0 * shifted, np.ones((len(poses), 1))])
    solution = np.linalg.lstsq(lhs, (shifted**2).sum(axis=1), rcond=None)[0]
    radius = np.sqrt(max(solution[3] + solution[:3] @ solution[:3], 1e-300))
    return np.concatenate([np.full(3, radius / gravity_m_s2), middle + solution[:3], np.zeros(3)])


def _require_spread(poses: Float64Array) -> None:
    if poses.ndim != 2 or poses.shape[1] != 3 or len(poses) < _FEWEST_POSES:
        raise RigError(
            f"{len(poses)} attitudes at rest; expected {_FEWEST_POSES} or more, each side of the "
            "sensor up once, and some tilted between"
        )
    shifted = poses - poses.mean(axis=0)
    spread = np.linalg.svd(shifted, compute_uv=False)
    if spread[2] < _LEAST_SPREAD * spread[0]:
        raise RigError(
            f"the attitudes spread {spread[2] / spread[0]:.2f} as far in their weakest direction "
            f"as in their strongest; expected {_LEAST_SPREAD} or more: turn the sensor to its "
            "other sides"
        )
