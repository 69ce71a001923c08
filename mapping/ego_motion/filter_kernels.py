"""The filter's arithmetic: rows of measurements in order of time, one state after another (numba).

An extended Kalman filter over `states`. Between rows the state moves by

    x' = v cos p cos yaw     y' = v cos p sin yaw     z' = -v sin p
    yaw' = (p' tan r + turn / cos r) / cos p

with v = u / (1 + s + k) the rover's speed by that of its wheels, and r, p the levelled roll and
pitch less their estimated errors. The last line is the rate of yaw on a slope, yaw' = (w_y sin r
+ w_z cos r) / cos p, with the w_y that a changing pitch needs, p' = w_y cos r - w_z sin r. The turn
is a random walk that is pulled back to 0, u the sum of an acceleration; acceleration, slip and the
tilt's errors are Gauss-Markov processes. Readings of the wheels concern u alone: their derivative
by s and k would be v with its errors, and would drag s along. With every state comes PHI, the
derivative of its error by the error one tick before, measurements included: from it follow
covariances between times.

All compiled code of the filter is in this file: numba looks for changes in the file of a cached
kernel, not in what it calls.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from mapping.ego_motion.filter_types import (
    FilterConstants,
    Float64Array,
    Int64Array,
    Rows,
    States,
)
from mapping.ego_motion.states import (
    ACCELERATION,
    FORCE_ERROR,
    GYRO,
    GYRO_BIAS,
    PITCH_BIAS,
    PITCH_ERROR,
    POSE,
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
    TICK_SINCE_S,
    TICK_SLIP_VARIANCE,
    TICK_SPEED_WALK,
    TICK_STILL,
    TRACK_ERROR,
    TURN,
    VIBRATION,
    VIBRATION_SCALE,
    WHEEL_SCALE,
    WHEELS,
    YAW,
    X,
    Y,
    Z,
)

# Outcomes of a row.
TAKEN, SURPRISED, LEFT_OUT = range(3)
# So many times as fast as the rover are its wheels: at least, and at most where a pose tells its
# speed. Wheels slower than `_CREEP_M_S` have no such ratio.
_LEAST_FACTOR, _MOST_FACTOR = 0.2, 5.0
_CREEP_M_S = 0.02
# Wheels that suddenly turn by less than this share of before are locked.
_LOCKED = 0.3
# A tilt whose variance falls below this share from tick to tick was lost and is found again.
_FOUND_AGAIN = 0.1


@njit(cache=True)
def run(
    state: States,
    rows: Rows,
    end_ns: int,
    c: FilterConstants,
    out: States,
    outcome: Int64Array,
    nis: Float64Array,
) -> int:
    """Take all rows, then move to `end_ns`; return the number of ticks written to `out`.

    Args:
        state: one state (N = 1); it is overwritten by the last one. Its phi is the product since
            whatever time the caller chose, and starts anew at every tick.
        rows: none is earlier than the state, none later than `end_ns`.
        end_ns: where to end.
        c, out: constants; room for a state at every tick.
        outcome, nis: (M,) what became of each row, and its normalised innovation squared.
    """
    x, p, phi, held = state.x[0], state.p[0], state.phi[0], state.held[0]
    t_ns = state.t_ns[0]
    tick_ns = t_ns - round(1e9 * held[TICK_SINCE_S])
    written = 0
    for i in range(len(rows.t_ns)):
        _move(x, p, phi, held, (t_ns - tick_ns) * 1e-9, (rows.t_ns[i] - t_ns) * 1e-9, c)
        t_ns, value = rows.t_ns[i], rows.values[i]
        if rows.kind[i] == GYRO:
            outcome[i], nis[i] = _gyro(x, p, phi, held, value, c)
        elif rows.kind[i] == WHEELS:
            outcome[i], nis[i] = _wheels(x, p, phi, value, c)
        elif rows.kind[i] == VIBRATION:
            outcome[i], nis[i] = _vibration(x, p, phi, value, c)
        elif rows.kind[i] == POSE:
            which = round(value[0])
            gate = c.pose_gate_nis if value[1] > 0.0 else np.inf
            seconds = (t_ns - tick_ns) * 1e-9
            outcome[i], nis[i] = _pose(
                x, p, phi, held, seconds, rows.poses[which], rows.pose_covariances[which], gate
            )
        else:
            _take_tilt(x, p, phi, held, value)
            held[:] = value
            if not _is_free(held):
                _renew(x, p, phi, ACCELERATION, 0.0)
            tick_ns = t_ns
            _standstill(x, p, phi, held, c)
            _symmetric(p)
            out.t_ns[written] = t_ns
            out.x[written] = x
            out.p[written] = p
            out.phi[written] = phi
            out.held[written] = held
            out.held[written, TICK_SINCE_S] = 0.0
            written += 1
            phi[:] = np.eye(SIZE)
    _move(x, p, phi, held, (t_ns - tick_ns) * 1e-9, (end_ns - t_ns) * 1e-9, c)
    state.t_ns[0] = end_ns
    held[TICK_SINCE_S] = (end_ns - tick_ns) * 1e-9
    return written


@njit(inline="always")
def _move(
    x: Float64Array,
    p: Float64Array,
    phi: Float64Array,
    held: Float64Array,
    since_tick_s: float,
    dt: float,
    c: FilterConstants,
) -> None:
    """Move state, covariance and PHI by dt seconds."""
    if dt <= 0.0:
        return
    middle = since_tick_s + 0.5 * dt
    roll = held[TICK_ROLL] + held[TICK_ROLL_RATE] * middle - x[ROLL_ERROR] - x[ROLL_BIAS]
    pitch = held[TICK_PITCH] + held[TICK_PITCH_RATE] * middle - x[PITCH_ERROR] - x[PITCH_BIAS]
    sr, cr, sp, cp = math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch)
    sy, cy = math.sin(x[YAW]), math.cos(x[YAW])
    factor = _factor(x)
    v = x[SPEED] / factor
    steep = held[TICK_PITCH_RATE] / (cr * cr) + x[TURN] * sr / (cr * cr)
    a = np.zeros((4, 4))
    # Columns: yaw (of x, y) or turn (of yaw); v or roll error; pitch error.
    a[0] = (-v * cp * sy * dt, cp * cy * dt, v * sp * cy * dt, 0.0)
    a[1] = (v * cp * cy * dt, cp * sy * dt, v * sp * sy * dt, 0.0)
    a[2] = (0.0, -sp * dt, v * cp * dt, 0.0)
    # The rate of the levelled pitch has the rate of its error in it; by parts this is the change
    # of tan r times that error.
    rate = (held[TICK_PITCH_RATE] * sr / cr + x[TURN] / cr) / cp
    a[2, 3] = -rate * sp / cp * dt  # of the yaw, by the pitch
    a[3] = (dt / (cr * cp), -steep / cp * dt, held[TICK_ROLL_RATE] / (cr * cr * cp) * dt, 0.0)
    d = np.ones(SIZE)
    # A walk of density q, pulled back with time tau, stays within sqrt(q tau / 2).
    walk = c.acceleration_walk if _is_free(held) else held[TICK_SPEED_WALK]
    d[SPEED] = math.exp(-0.5 * dt * walk / (c.speed_sigma_m_s * c.speed_sigma_m_s))
    d[ACCELERATION] = math.exp(-dt / c.acceleration_time_s)
    d[TURN] = math.exp(-dt / c.turn_time_s)
    d[SLIP] = math.exp(-dt / c.slip_time_s)
    d[ROLL_ERROR] = d[PITCH_ERROR] = math.exp(-dt / c.levelling_time_s)
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
        speeds = (factor, v, _factor(x), after, dt)
        x[SPEED] = after * speeds[2]
    else:
        speeds = (factor, v, 1.0, 0.0, dt if held[TICK_STILL] == 0.0 else 0.0)
        x[SPEED] = (x[SPEED] + acceleration * speeds[4]) * d[SPEED]
    _row_steps(p, a, d, speeds, guided)
    _row_steps(p.T, a, d, speeds, guided)
    _row_steps(phi, a, d, speeds, guided)
    _noise(p, held, v, x[SLIP], sy, cy, d, dt, c)


@njit(inline="always")
def _factor(x: Float64Array) -> float:
    """Return the speed of the wheels over that of the rover."""
    return float(max(1.0 + x[WHEEL_SCALE] + x[SLIP], _LEAST_FACTOR))


@njit(inline="always")
def _is_free(held: Float64Array) -> bool:
    """Tell whether the rover moves, and no force tells its acceleration."""
    return bool(held[TICK_STILL] == 0.0 and held[TICK_REST_VARIANCE] == 0.0)


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
    """Add what dt seconds add to the covariance."""
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
        _slip_more(p, v, fresh)  # the rover's own speed does not ask for the wheels
    else:
        p[SLIP, SLIP] += fresh
    fresh = 1.0 - d[ACCELERATION] * d[ACCELERATION]
    p[ACCELERATION, ACCELERATION] += fresh * c.acceleration_m_s2 * c.acceleration_m_s2
    fresh = 1.0 - d[ROLL_ERROR] * d[ROLL_ERROR]
    p[ROLL_ERROR, ROLL_ERROR] += fresh * held[TICK_ROLL_VARIANCE]
    p[PITCH_ERROR, PITCH_ERROR] += fresh * held[TICK_PITCH_VARIANCE]


@njit(inline="always")
def _slip_more(p: Float64Array, v: float, variance: float) -> None:
    """Let the slip be less certain, and the wheels' speed with it: that of the rover stays."""
    p[SLIP, SLIP] += variance
    p[SLIP, SPEED] += v * variance
    p[SPEED, SLIP] += v * variance
    p[SPEED, SPEED] += v * v * variance


@njit(inline="always")
def _row_steps(
    m: Float64Array,
    a: Float64Array,
    d: Float64Array,
    speeds: tuple[float, float, float, float, float],
    guided: bool,
) -> None:
    """Multiply by the derivative of a step from the left, in place; see `_move` for `a`.

    `speeds`: 1 + s + k and v before and after the step, and its seconds.
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
def _scalar(
    x: Float64Array,
    p: Float64Array,
    phi: Float64Array,
    i: int,
    hi: float,
    j: int,
    hj: float,
    k: int,
    hk: float,
    innovation: float,
    variance: float,
    gate_nis: float,
) -> tuple[int, float]:
    """Update by one number whose derivative has up to three entries (index -1: none)."""
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
def _gyro(
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
        outcome, nis = _scalar(
            x, p, phi, TURN, 1.0, GYRO_BIAS, 1.0, -1, 0.0,
            value[0] - x[TURN] - x[GYRO_BIAS], value[1], gate,
        )  # fmt: skip
        if outcome == TAKEN:
            break
        held[TICK_STILL] = 0.0
        p[TURN, TURN] += c.turn_sigma_rad_s * c.turn_sigma_rad_s
    return outcome, nis


@njit(inline="always")
def _wheels(
    x: Float64Array, p: Float64Array, phi: Float64Array, value: Float64Array, c: FilterConstants
) -> tuple[int, float]:
    """Update by a twist of the wheels.

    A speed that cannot be is taken for slip: the rover goes on as before, its wheels do not.
    Wheels that stop all at once are locked and say nothing about the rover.
    """
    if value[4] == 0.0:
        return LEFT_OUT, np.nan
    outcome, nis = _scalar(
        x, p, phi, SPEED, 1.0, -1, 0.0, -1, 0.0, value[0] - x[SPEED], value[1], c.gate_nis
    )  # fmt: skip
    if outcome == LEFT_OUT:
        outcome = SURPRISED
        if abs(value[0]) < _LOCKED * abs(x[SPEED]):
            return outcome, nis
        _slip_more(p, x[SPEED] / _factor(x), c.slip_surprise * c.slip_surprise)
        _scalar(
            x, p, phi, SPEED, 1.0, -1, 0.0, -1, 0.0, value[0] - x[SPEED], value[1], np.inf
        )  # fmt: skip
    _scalar(
        x, p, phi, TURN, 1.0 + x[TRACK_ERROR], TRACK_ERROR, x[TURN], -1, 0.0,
        value[2] - x[TURN] * (1.0 + x[TRACK_ERROR]), value[3], c.gate_nis,
    )  # fmt: skip
    return outcome, nis


@njit(inline="always")
def _vibration(
    x: Float64Array, p: Float64Array, phi: Float64Array, value: Float64Array, c: FilterConstants
) -> tuple[int, float]:
    """Update by a speed that the vibration tells.

    The rover's speed is u / (1 + s + k); the part of its derivative by s is left out: where
    vibration is needed there are no wheels, and s and k move u alone.
    """
    scale, v = 1.0 + x[VIBRATION_SCALE], x[SPEED] / _factor(x)
    return _scalar(
        x, p, phi, SPEED, scale / _factor(x), VIBRATION_SCALE, v, SLIP, -scale * v / _factor(x),
        value[0] - v * scale, value[1], c.gate_nis,
    )  # fmt: skip


@njit(inline="always")
def _take_tilt(
    x: Float64Array, p: Float64Array, phi: Float64Array, held: Float64Array, value: Float64Array
) -> None:
    """Begin the tilt's errors anew where a tilt that was lost is found again."""
    for axis in range(2):
        variance = value[TICK_ROLL_VARIANCE + axis]
        if variance < _FOUND_AGAIN * held[TICK_ROLL_VARIANCE + axis]:
            _renew(x, p, phi, ROLL_ERROR + axis, variance)


@njit(inline="always")
def _renew(x: Float64Array, p: Float64Array, phi: Float64Array, i: int, variance: float) -> None:
    """Let a state be a new draw that has nothing to do with what was before."""
    phi[i, :] = p[i, :] = p[:, i] = x[i] = 0.0
    p[i, i] = variance


@njit(inline="always")
def _standstill(
    x: Float64Array, p: Float64Array, phi: Float64Array, held: Float64Array, c: FilterConstants
) -> None:
    """Speed and turn are 0 while the rover stands; a turning rover does not stand."""
    if held[TICK_STILL] == 0.0:
        return
    # The next departure refers to this rest: an error of its own.
    _renew(x, p, phi, FORCE_ERROR, held[TICK_REST_VARIANCE])
    outcome, _ = _scalar(
        x, p, phi, TURN, 1.0, -1, 0.0, -1, 0.0, -x[TURN], c.zero_rate_rad_s**2, c.gate_nis
    )  # fmt: skip
    if outcome == LEFT_OUT:
        held[TICK_STILL] = 0.0
        return
    sigma = c.zero_speed_m_s if held[TICK_STILL] == 2.0 else c.zero_speed_alone_m_s
    _scalar(x, p, phi, SPEED, 1.0, -1, 0.0, -1, 0.0, -x[SPEED], sigma * sigma, np.inf)


@njit(inline="always")
def _pose(
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
    v = x[SPEED] / _factor(x)
    v += (change[SPEED] - v * (change[WHEEL_SCALE] + change[SLIP])) / _factor(x)
    x += change
    _slip_to(x, v)
    p -= gain @ hp
    phi -= gain @ (h @ phi)
    _symmetric(p)
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
    x[SLIP] = min(max(factor, _LEAST_FACTOR), _MOST_FACTOR) - scale


@njit(inline="always")
def _symmetric(p: Float64Array) -> None:
    """Make a covariance symmetric to the bit."""
    for i in range(SIZE):
        for j in range(i):
            p[i, j] = p[j, i] = 0.5 * (p[i, j] + p[j, i])
