"""What measurements change in the filter's state (numba).

Readings of the wheels concern u alone: their derivative by s and k would be v with its errors, and
would drag s along.

Arguments that many of these take: x (SIZE,), p and phi (SIZE, SIZE) the state, its covariance and
PHI, all changed in place; held (COLUMNS,) the last tick's row; value (COLUMNS,) the row of the
measurement, see `states`; c the constants. An update returns its outcome and the normalised
innovation squared. A change here takes effect with `PARTS_CRC32` of `filter_kernels`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from mapping.ego_motion.filter_motion import LEAST_FACTOR, slip_more, wheel_factor
from mapping.ego_motion.filter_types import FilterConstants, Float64Array
from mapping.ego_motion.states import (
    FORCE_ERROR,
    GYRO_BIAS,
    PITCH_BIAS,
    PITCH_ERROR,
    ROLL_BIAS,
    ROLL_ERROR,
    SIZE,
    SLIP,
    SPEED,
    TICK_PITCH,
    TICK_PITCH_RATE,
    TICK_REST_VARIANCE,
    TICK_ROLL,
    TICK_ROLL_RATE,
    TICK_ROLL_VARIANCE,
    TICK_STILL,
    TRACK_ERROR,
    TURN,
    VIBRATION_SCALE,
    WHEEL_SCALE,
    YAW,
    X,
    Y,
    Z,
)

# Outcomes of a row.
TAKEN, SURPRISED, LEFT_OUT = range(3)
# So many times as fast as the rover are its wheels at most, where a pose tells its speed. Wheels
# slower than `_CREEP_M_S` have no such ratio.
_MOST_FACTOR = 5.0
_CREEP_M_S = 0.02
# Wheels that suddenly turn by less than this share of before are locked.
_LOCKED = 0.3
# A tilt whose variance falls below this share from tick to tick was lost and is found again.
_FOUND_AGAIN = 0.1

Entry = tuple[int, float]
"""A state, and the derivative of a measurement by it."""

_NO_ENTRY = (-1, 0.0)


@njit(inline="always")
def update_by_gyro(
    x: Float64Array,
    p: Float64Array,
    phi: Float64Array,
    held: Float64Array,
    value: Float64Array,
    c: FilterConstants,
) -> tuple[int, float]:
    """Update by a yaw rate; one that no rover at rest shows ends the rest, until the next tick.

    Otherwise a turn that begins unnoticed would be learned as bias.
    """
    for attempt in range(2):
        gate = c.gate_nis if held[TICK_STILL] > 0.0 and attempt == 0 else np.inf
        by = ((TURN, 1.0), (GYRO_BIAS, 1.0), _NO_ENTRY)
        outcome, nis = _scalar(x, p, phi, by, value[0] - x[TURN] - x[GYRO_BIAS], value[1], gate)
        if outcome == TAKEN:
            break
        held[TICK_STILL] = 0.0
        p[TURN, TURN] += c.turn_sigma_rad_s * c.turn_sigma_rad_s
    return outcome, nis


@njit(inline="always")
def update_by_wheels(
    x: Float64Array, p: Float64Array, phi: Float64Array, value: Float64Array, c: FilterConstants
) -> tuple[int, float]:
    """Update by a twist of the wheels.

    A speed that cannot be is taken for slip: the rover goes on as before, its wheels do not.
    Wheels that stop all at once are locked and say nothing about the rover.
    """
    if value[4] == 0.0:
        return LEFT_OUT, np.nan
    by_speed = ((SPEED, 1.0), _NO_ENTRY, _NO_ENTRY)
    outcome, nis = _scalar(x, p, phi, by_speed, value[0] - x[SPEED], value[1], c.gate_nis)
    if outcome == LEFT_OUT:
        outcome = SURPRISED
        if abs(value[0]) < _LOCKED * abs(x[SPEED]):
            return outcome, nis
        slip_more(p, x[SPEED] / wheel_factor(x), c.slip_surprise * c.slip_surprise)
        _scalar(x, p, phi, by_speed, value[0] - x[SPEED], value[1], np.inf)
    by_turn = ((TURN, 1.0 + x[TRACK_ERROR]), (TRACK_ERROR, x[TURN]), _NO_ENTRY)
    turn_error = value[2] - x[TURN] * (1.0 + x[TRACK_ERROR])
    _scalar(x, p, phi, by_turn, turn_error, value[3], c.gate_nis)
    return outcome, nis


@njit(inline="always")
def update_by_vibration(
    x: Float64Array, p: Float64Array, phi: Float64Array, value: Float64Array, c: FilterConstants
) -> tuple[int, float]:
    """Update by a speed that the vibration tells.

    The rover's speed is u / (1 + s + k); the part of its derivative by s is left out: where
    vibration is needed there are no wheels, and s and k move u alone.
    """
    factor = wheel_factor(x)
    scale, v = 1.0 + x[VIBRATION_SCALE], x[SPEED] / factor
    by = ((SPEED, scale / factor), (VIBRATION_SCALE, v), (SLIP, -scale * v / factor))
    return _scalar(x, p, phi, by, value[0] - v * scale, value[1], c.gate_nis)


@njit(inline="always")
def update_by_pose(
    x: Float64Array,
    p: Float64Array,
    phi: Float64Array,
    held: Float64Array,
    since_tick_s: float,
    pose: Float64Array,
    covariance: Float64Array,
    gate_nis: float,
) -> tuple[int, float]:
    """Update by a whole pose: x, y, z, roll, pitch, yaw."""
    h = np.zeros((6, SIZE))
    h[0, X] = h[1, Y] = h[2, Z] = h[5, YAW] = 1.0
    h[3, ROLL_ERROR] = h[3, ROLL_BIAS] = h[4, PITCH_ERROR] = h[4, PITCH_BIAS] = -1.0
    innovation = pose - h @ x
    innovation[3] -= held[TICK_ROLL] + held[TICK_ROLL_RATE] * since_tick_s
    innovation[4] -= held[TICK_PITCH] + held[TICK_PITCH_RATE] * since_tick_s
    innovation[5] -= 2.0 * math.pi * round(innovation[5] / (2.0 * math.pi))
    hp = h @ p
    s = hp @ np.ascontiguousarray(h.T) + covariance
    gain = np.ascontiguousarray(np.linalg.solve(s, hp).T)
    nis = float(innovation @ np.linalg.solve(s, innovation))
    if not nis <= gate_nis:
        return LEFT_OUT, nis
    change = gain @ innovation
    v = x[SPEED] / wheel_factor(x)
    v += (change[SPEED] - v * (change[WHEEL_SCALE] + change[SLIP])) / wheel_factor(x)
    x += change
    _slip_to(x, v)
    p -= gain @ hp
    phi -= gain @ (h @ phi)
    make_symmetric(p)
    return TAKEN, nis


@njit(inline="always")
def update_by_standstill(
    x: Float64Array, p: Float64Array, phi: Float64Array, held: Float64Array, c: FilterConstants
) -> None:
    """Speed and turn are 0 while the rover stands; a turning rover does not stand."""
    if held[TICK_STILL] == 0.0:
        return
    # The next departure refers to this rest: an error of its own.
    renew(x, p, phi, FORCE_ERROR, held[TICK_REST_VARIANCE])
    by_turn = ((TURN, 1.0), _NO_ENTRY, _NO_ENTRY)
    outcome, _ = _scalar(x, p, phi, by_turn, -x[TURN], c.zero_rate_rad_s**2, c.gate_nis)
    if outcome == LEFT_OUT:
        held[TICK_STILL] = 0.0
        return
    sigma = c.zero_speed_m_s if held[TICK_STILL] == 2.0 else c.zero_speed_alone_m_s
    by_speed = ((SPEED, 1.0), _NO_ENTRY, _NO_ENTRY)
    _scalar(x, p, phi, by_speed, -x[SPEED], sigma * sigma, np.inf)


@njit(inline="always")
def take_tilt(
    x: Float64Array, p: Float64Array, phi: Float64Array, held: Float64Array, value: Float64Array
) -> None:
    """Begin the tilt's errors anew where a tilt that was lost is found again."""
    for axis in range(2):
        variance = value[TICK_ROLL_VARIANCE + axis]
        if variance < _FOUND_AGAIN * held[TICK_ROLL_VARIANCE + axis]:
            renew(x, p, phi, ROLL_ERROR + axis, variance)


@njit(inline="always")
def renew(x: Float64Array, p: Float64Array, phi: Float64Array, i: int, variance: float) -> None:
    """Let a state be a new draw that has nothing to do with what was before."""
    phi[i, :] = p[i, :] = p[:, i] = x[i] = 0.0
    p[i, i] = variance


@njit(inline="always")
def _scalar(
    x: Float64Array,
    p: Float64Array,
    phi: Float64Array,
    by: tuple[Entry, Entry, Entry],
    innovation: float,
    variance: float,
    gate_nis: float,
) -> tuple[int, float]:
    """Update by one number.

    Args:
        x, p, phi: as everywhere.
        by: the number's derivative by the state, as up to three entries; the rest are `_NO_ENTRY`.
        innovation, variance: measured less expected, and the measurement's variance.
        gate_nis: beyond it the number is left out.
    """
    i, hi = by[0]
    j, hj = by[1]
    k, hk = by[2]
    ph = hi * p[:, i]
    hphi = hi * phi[i]
    if j >= 0:
        ph += hj * p[:, j]
        hphi += hj * phi[j]
    if k >= 0:
        ph += hk * p[:, k]
        hphi += hk * phi[k]
    s = variance + hi * ph[i]
    if j >= 0:
        s += hj * ph[j]
    if k >= 0:
        s += hk * ph[k]
    nis = innovation * innovation / s
    if nis > gate_nis:
        return LEFT_OUT, nis
    for m in range(SIZE):
        gain = ph[m] / s
        x[m] += gain * innovation
        for n in range(SIZE):
            p[m, n] -= gain * ph[n]
            phi[m, n] -= gain * hphi[n]
    return TAKEN, nis


@njit(inline="always")
def _slip_to(x: Float64Array, v: float) -> None:
    """Let the slip be what makes v the rover's speed, within what a slip can be.

    What an update adds to the slip itself is right for small changes only: of wheels that spin in
    place the slip is anything from large to negative, with the rover's speed next to 0 throughout.
    """
    scale = 1.0 + x[WHEEL_SCALE]
    factor = scale + x[SLIP]
    if abs(x[SPEED]) > _CREEP_M_S:
        factor = 1.0 / max(v / x[SPEED], 1.0 / _MOST_FACTOR)
    x[SLIP] = min(max(factor, LEAST_FACTOR), _MOST_FACTOR) - scale


@njit(inline="always")
def make_symmetric(p: Float64Array) -> None:
    """Make a covariance symmetric to the bit."""
    for i in range(SIZE):
        for j in range(i):
            p[i, j] = p[j, i] = 0.5 * (p[i, j] + p[j, i])
