"""The filter's arithmetic: rows of measurements in order of time, one state after another (numba).

An extended Kalman filter over `states`: between rows the state moves (`filter_motion`), each row
changes it (`filter_updates`). With every state comes PHI, the derivative of its error by the error
one tick before, measurements included: from it follow covariances between times.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mapping.ego_motion.filter_motion import is_free, move
from mapping.ego_motion.filter_types import (
    FilterConstants,
    Float64Array,
    Int64Array,
    Rows,
    States,
)
from mapping.ego_motion.filter_updates import (
    make_symmetric,
    renew,
    take_tilt,
    update_by_gyro,
    update_by_pose,
    update_by_standstill,
    update_by_vibration,
    update_by_wheels,
)
from mapping.ego_motion.states import (
    ACCELERATION,
    GYRO,
    POSE,
    SIZE,
    TICK_SINCE_S,
    VIBRATION,
    WHEELS,
)

# numba compiles `run` anew when this file changes, and looks at no other. This number stands for
# the files that it takes code and numbers from: tests/mapping/test_kernel_cache.py compares it.
PARTS_CRC32 = 0x134F1525


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
        move(x, p, phi, held, (t_ns - tick_ns) * 1e-9, (rows.t_ns[i] - t_ns) * 1e-9, c)
        t_ns, value = rows.t_ns[i], rows.values[i]
        if rows.kind[i] == GYRO:
            outcome[i], nis[i] = update_by_gyro(x, p, phi, held, value, c)
        elif rows.kind[i] == WHEELS:
            outcome[i], nis[i] = update_by_wheels(x, p, phi, value, c)
        elif rows.kind[i] == VIBRATION:
            outcome[i], nis[i] = update_by_vibration(x, p, phi, value, c)
        elif rows.kind[i] == POSE:
            which = round(value[0])
            gate = c.pose_gate_nis if value[1] > 0.0 else np.inf
            seconds = (t_ns - tick_ns) * 1e-9
            outcome[i], nis[i] = update_by_pose(
                x, p, phi, held, seconds, rows.poses[which], rows.pose_covariances[which], gate
            )
        else:
            tick_ns = t_ns
            take_tilt(x, p, phi, held, value)
            held[:] = value
            if not is_free(held):
                renew(x, p, phi, ACCELERATION, 0.0)
            update_by_standstill(x, p, phi, held, c)
            make_symmetric(p)
            out.t_ns[written], out.x[written], out.p[written] = t_ns, x, p
            out.phi[written], out.held[written] = phi, held
            out.held[written, TICK_SINCE_S] = 0.0
            written += 1
            phi[:] = np.eye(SIZE)
    move(x, p, phi, held, (t_ns - tick_ns) * 1e-9, (end_ns - t_ns) * 1e-9, c)
    state.t_ns[0] = end_ns
    held[TICK_SINCE_S] = (end_ns - tick_ns) * 1e-9
    return written
