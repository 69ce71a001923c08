"""One step of the filter: how its state moves, and what that adds to the covariance (numba).

    x' = v cos p cos yaw     y' = v cos p sin yaw     z' = -v sin p
    yaw' = (p' tan r + turn / cos r) / cos p

with v = u / (1 + s + k) the rover's speed by that of its wheels, and r, p the levelled roll and
pitch less their estimated errors. The last line is the rate of yaw on a slope, yaw' = (w_y sin r
+ w_z cos r) / cos p, with the w_y that a changing pitch needs, p' = w_y cos r - w_z sin r. The turn
is a random walk that is pulled back to 0, u the sum of an acceleration; acceleration, slip and the
tilt's errors are Gauss-Markov processes.

Arguments that many of these take: x (SIZE,), p and phi (SIZE, SIZE) the state, its covariance and
PHI, all changed in place; held (COLUMNS,) the last tick's row; c the constants. A change here takes
effect with `PARTS_CRC32` of `filter_kernels`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from mapping.ego_motion.filter_types import FilterConstants, Float64Array
from mapping.ego_motion.states import (
    ACCELERATION,
    FORCE_ERROR,
    GYRO_BIAS,
    PITCH_BIAS,
    PITCH_ERROR,
    ROLL_BIAS,
    ROLL_ERROR,
    SIZE,
    SLIP,
    SPEED,
    TICK_FORCE,
    TICK_PITCH,
    TICK_PITCH_RATE,
    TICK_PITCH_VARIANCE,
    TICK_REST_VARIANCE,
    TICK_ROLL,
    TICK_ROLL_RATE,
    TICK_ROLL_VARIANCE,
    TICK_SLIP_VARIANCE,
    TICK_SPEED_WALK,
    TICK_STILL,
    TURN,
    WHEEL_SCALE,
    YAW,
    X,
    Y,
    Z,
)

# So many times as fast as the rover are its wheels at least.
LEAST_FACTOR = 0.2


@njit(inline="always")
def move(
    x: Float64Array,
    p: Float64Array,
    phi: Float64Array,
    held: Float64Array,
    since_tick_s: float,
    dt: float,
    c: FilterConstants,
) -> None:
    """Move state, covariance and PHI by dt seconds, which begin `since_tick_s` after the tick."""
    if dt <= 0.0:
        return
    middle = since_tick_s + 0.5 * dt
    roll = held[TICK_ROLL] + held[TICK_ROLL_RATE] * middle - x[ROLL_ERROR] - x[ROLL_BIAS]
    pitch = held[TICK_PITCH] + held[TICK_PITCH_RATE] * middle - x[PITCH_ERROR] - x[PITCH_BIAS]
    sr, cr, sp, cp = math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch)
    sy, cy = math.sin(x[YAW]), math.cos(x[YAW])
    factor = wheel_factor(x)
    v = x[SPEED] / factor
    rate = (held[TICK_PITCH_RATE] * sr / cr + x[TURN] / cr) / cp
    a = _step_derivative(held, x[TURN], v, rate, (sr, cr, sp, cp, sy, cy), dt)
    d = _kept_shares(held, dt, c)
    x[X] += v * cp * cy * dt
    x[Y] += v * cp * sy * dt
    x[Z] -= v * sp * dt
    x[YAW] += rate * dt
    acceleration = x[ACCELERATION]
    for i in range(SIZE):
        if i != SPEED:
            x[i] *= d[i]
    guided = held[TICK_REST_VARIANCE] > 0.0
    if guided:
        after = (v + (held[TICK_FORCE] - x[FORCE_ERROR]) * dt) * d[SPEED]
        speeds = (factor, v, wheel_factor(x), after, dt)
        x[SPEED] = after * speeds[2]
    else:
        speeds = (factor, v, 1.0, 0.0, dt if held[TICK_STILL] == 0.0 else 0.0)
        x[SPEED] = (x[SPEED] + acceleration * speeds[4]) * d[SPEED]
    _row_steps(p, a, d, speeds, guided)
    _row_steps(p.T, a, d, speeds, guided)
    _row_steps(phi, a, d, speeds, guided)
    _noise(p, held, v, x[SLIP], sy, cy, d, dt, c)


@njit(inline="always")
def _step_derivative(
    held: Float64Array,
    turn: float,
    v: float,
    rate: float,
    sines: tuple[float, float, float, float, float, float],
    dt: float,
) -> Float64Array:
    """Return (4, 4): x, y, z and yaw after a step by yaw (x, y) or turn (yaw); v or roll; pitch.

    Args:
        held, turn, v, dt: the tick's row, the state's turn, the rover's speed, the step.
        rate: of the yaw.
        sines: sine and cosine of roll, of pitch, and of yaw.
    """
    sr, cr, sp, cp, sy, cy = sines
    steep = held[TICK_PITCH_RATE] / (cr * cr) + turn * sr / (cr * cr)
    a = np.zeros((4, 4))
    a[0] = (-v * cp * sy * dt, cp * cy * dt, v * sp * cy * dt, 0.0)
    a[1] = (v * cp * cy * dt, cp * sy * dt, v * sp * sy * dt, 0.0)
    a[2] = (0.0, -sp * dt, v * cp * dt, 0.0)
    # The rate of the levelled pitch has the rate of its error in it; by parts this is the change
    # of tan r times that error.
    a[2, 3] = -rate * sp / cp * dt  # of the yaw, by the pitch
    a[3] = (dt / (cr * cp), -steep / cp * dt, held[TICK_ROLL_RATE] / (cr * cr * cp) * dt, 0.0)
    return a


@njit(inline="always")
def _kept_shares(held: Float64Array, dt: float, c: FilterConstants) -> Float64Array:
    """Return (SIZE,) the share of each state that is left after dt seconds."""
    d = np.ones(SIZE)
    # A walk of density q, pulled back with time tau, stays within sqrt(q tau / 2).
    walk = c.acceleration_walk if is_free(held) else held[TICK_SPEED_WALK]
    d[SPEED] = math.exp(-0.5 * dt * walk / (c.speed_sigma_m_s * c.speed_sigma_m_s))
    d[ACCELERATION] = math.exp(-dt / c.acceleration_time_s)
    d[TURN] = math.exp(-dt / c.turn_time_s)
    d[SLIP] = math.exp(-dt / c.slip_time_s)
    d[ROLL_ERROR] = d[PITCH_ERROR] = math.exp(-dt / c.levelling_time_s)
    return d


@njit(inline="always")
def _noise(
    p: Float64Array,
    held: Float64Array,
    v: float,
    slip: float,
    sy: float,
    cy: float,
    d: Float64Array,
    dt: float,
    c: FilterConstants,
) -> None:
    """Add what dt seconds add to the covariance.

    Args:
        p, held, dt, c: as everywhere.
        v: the rover's speed.
        slip: after the step.
        sy, cy: sine and cosine of the yaw.
        d: (SIZE,) of `_kept_shares`.
    """
    side = 2.0 * c.lateral_slip_time_s * (c.lateral_slip_ratio * v) ** 2 * dt
    p[X, X] += side * sy * sy
    p[Y, Y] += side * cy * cy
    p[X, Y] -= side * sy * cy
    p[Y, X] -= side * sy * cy
    p[Z, Z] += 2.0 * c.lateral_slip_time_s * (c.vertical_walk_ratio * v) ** 2 * dt
    if held[TICK_STILL] == 0.0:
        p[SPEED, SPEED] += held[TICK_SPEED_WALK] * dt
        p[TURN, TURN] += c.turn_walk * c.turn_walk * dt
    else:
        # At rest nothing changes by more, from tick to tick, than is assumed of rest itself;
        # otherwise every reading of the gyro would be as far from rest as a turning rover's.
        p[SPEED, SPEED] += c.zero_speed_m_s**2 / c.tick_s * dt
        p[TURN, TURN] += c.zero_rate_rad_s**2 / c.tick_s * dt
    if held[TICK_REST_VARIANCE] > 0.0:
        p[FORCE_ERROR, FORCE_ERROR] += c.force_walk * c.force_walk * dt
    p[GYRO_BIAS, GYRO_BIAS] += c.gyro_bias_walk * c.gyro_bias_walk * dt
    p[WHEEL_SCALE, WHEEL_SCALE] += c.wheel_scale_walk * c.wheel_scale_walk * dt
    # Wheels that slip by half may grip again at any moment, or go on.
    fresh = (1.0 - d[SLIP] * d[SLIP]) * (held[TICK_SLIP_VARIANCE] + slip * slip)
    if held[TICK_REST_VARIANCE] > 0.0:
        slip_more(p, v, fresh)  # the rover's own speed does not ask for the wheels
    else:
        p[SLIP, SLIP] += fresh
    fresh = 1.0 - d[ACCELERATION] * d[ACCELERATION]
    p[ACCELERATION, ACCELERATION] += fresh * c.acceleration_m_s2 * c.acceleration_m_s2
    fresh = 1.0 - d[ROLL_ERROR] * d[ROLL_ERROR]
    p[ROLL_ERROR, ROLL_ERROR] += fresh * held[TICK_ROLL_VARIANCE]
    p[PITCH_ERROR, PITCH_ERROR] += fresh * held[TICK_PITCH_VARIANCE]


@njit(inline="always")
def _row_steps(
    m: Float64Array,
    a: Float64Array,
    d: Float64Array,
    speeds: tuple[float, float, float, float, float],
    guided: bool,
) -> None:
    """Multiply by the derivative of a step from the left, in place.

    Args:
        m: (SIZE, SIZE), is changed.
        a: of `_step_derivative`.
        d: (SIZE,) of `_kept_shares`.
        speeds: 1 + s + k and v before and after the step, and its seconds.
        guided: a force tells the rover's acceleration.
    """
    factor, v, factor_after, v_after, dt = speeds
    for k in range(SIZE):
        tilt = m[PITCH_ERROR, k] + m[PITCH_BIAS, k]
        own = (m[SPEED, k] - v * (m[WHEEL_SCALE, k] + m[SLIP, k])) / factor
        m[X, k] += a[0, 0] * m[YAW, k] + a[0, 1] * own + a[0, 2] * tilt
        m[Y, k] += a[1, 0] * m[YAW, k] + a[1, 1] * own + a[1, 2] * tilt
        m[Z, k] += a[2, 1] * own + a[2, 2] * tilt
        m[YAW, k] += (
            a[3, 0] * m[TURN, k]
            + a[3, 1] * (m[ROLL_ERROR, k] + m[ROLL_BIAS, k])
            + a[3, 2] * m[PITCH_ERROR, k]
            + a[2, 3] * tilt
        )
        m[TURN, k] *= d[TURN]
        m[SLIP, k] *= d[SLIP]
        if guided:
            own = (own - dt * m[FORCE_ERROR, k]) * d[SPEED]
            m[SPEED, k] = factor_after * own + v_after * (m[WHEEL_SCALE, k] + m[SLIP, k])
        else:
            m[SPEED, k] = (m[SPEED, k] + dt * m[ACCELERATION, k]) * d[SPEED]
        m[ROLL_ERROR, k] *= d[ROLL_ERROR]
        m[PITCH_ERROR, k] *= d[PITCH_ERROR]
        m[ACCELERATION, k] *= d[ACCELERATION]


@njit(inline="always")
def wheel_factor(x: Float64Array) -> float:
    """Return the speed of the wheels over that of the rover."""
    return float(max(1.0 + x[WHEEL_SCALE] + x[SLIP], LEAST_FACTOR))


@njit(inline="always")
def is_free(held: Float64Array) -> bool:
    """Tell whether the rover moves, and no force tells its acceleration."""
    return bool(held[TICK_STILL] == 0.0 and held[TICK_REST_VARIANCE] == 0.0)


@njit(inline="always")
def slip_more(p: Float64Array, v: float, variance: float) -> None:
    """Let the slip be less certain, and the wheels' speed with it: that of the rover stays."""
    p[SLIP, SLIP] += variance
    p[SLIP, SPEED] += v * variance
    p[SPEED, SLIP] += v * variance
    p[SPEED, SPEED] += v * v * variance
