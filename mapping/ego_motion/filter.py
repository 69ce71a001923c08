"""The filter over time: rows in, states at ticks kept, late poses taken by going back.

A pose that comes late is put where it belongs: the filter returns to the last tick before it and
takes all rows since once more. Whatever the order of arrival, the states are those of the order
of time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mapping.ego_motion.filter_kernels import run
from mapping.ego_motion.filter_start import begin, filter_constants
from mapping.ego_motion.filter_types import Int64Array, Rows, States
from mapping.ego_motion.filter_updates import LEFT_OUT, SURPRISED
from mapping.ego_motion.history import History, copied, empty_states
from mapping.ego_motion.settings import EgoMotionSettings
from mapping.ego_motion.states import (
    COLUMNS,
    PITCH_BIAS,
    PITCH_ERROR,
    POSE,
    ROLL_BIAS,
    ROLL_ERROR,
    SIZE,
    TICK,
    TICK_PITCH,
    TICK_PITCH_RATE,
    TICK_ROLL,
    TICK_ROLL_RATE,
    TICK_SINCE_S,
    WHEELS,
    YAW,
    X,
    Y,
    Z,
)
from mapping.geometry import Float64Array

# Of a state: x, y, z, roll, pitch, yaw, but for the levelled roll and pitch.
POSE_OF_STATE = np.zeros((6, SIZE))
POSE_OF_STATE[[0, 1, 2, 5], [X, Y, Z, YAW]] = 1.0
POSE_OF_STATE[[3, 3, 4, 4], [ROLL_ERROR, ROLL_BIAS, PITCH_ERROR, PITCH_BIAS]] = -1.0


@dataclass(frozen=True, slots=True)
class PoseMeasurement:
    """An external pose.

    Attributes:
        t_ns: its time.
        vector: (6,) x, y, z, roll, pitch, yaw of base_link in T.
        covariance: (6, 6) of the same.
        gated: left out when it is too unlikely.
    """

    t_ns: int
    vector: Float64Array
    covariance: Float64Array
    gated: bool


@dataclass(frozen=True, slots=True)
class Surprise:
    """A row that the filter could not believe."""

    t_ns: int
    kind: int
    nis: float


@dataclass(frozen=True, slots=True)
class PoseState:
    """A pose with what is needed for covariances with other times.

    Attributes:
        t_ns: the time.
        vector: (6,) x, y, z, roll, pitch, yaw of base_link in T.
        state: the whole state.
        index: of the last tick at or before it.
    """

    t_ns: int
    vector: Float64Array
    state: States
    index: int

    @property
    def covariance(self) -> Float64Array:
        """Return the (6, 6) covariance of `vector`."""
        return np.asarray(POSE_OF_STATE @ self.state.p[0] @ POSE_OF_STATE.T, np.float64)


class PoseFilter:
    """Keeps the states of the last seconds.

    Args:
        settings: of ego-motion.
        t_ns: time of the first tick.
        start: (6,) x, y, z, roll, pitch, yaw there; roll and pitch are replaced by levelled ones.
        start_covariance: (6, 6) of the same.
    """

    def __init__(
        self,
        settings: EgoMotionSettings,
        t_ns: int,
        start: Float64Array,
        start_covariance: Float64Array,
    ) -> None:
        self._constants = filter_constants(settings)
        self._history_ns = round(settings.history_s * 1e9)
        self._history = History(max(4, math.ceil(settings.history_s / settings.tick_s)))
        self._t_ns = np.zeros(0, np.int64)
        self._kind = np.zeros(0, np.int64)
        self._values = np.zeros((0, COLUMNS))
        self._poses: list[PoseMeasurement] = []
        begin(self._history.room_for(1), settings, t_ns, start, start_covariance)
        self._history.add(1)

    @property
    def newest_ns(self) -> int:
        """Time of the newest state."""
        return self._history.newest_ns

    @property
    def oldest_ns(self) -> int:
        """Time of the oldest state that is kept."""
        return self._history.oldest_ns

    def advance(self, t_ns: Int64Array, kind: Int64Array, values: Float64Array) -> list[Surprise]:
        """Take rows in order of time; the last is a tick. Return what was not believed."""
        keep = self._t_ns > self.newest_ns - self._history_ns
        self._t_ns = np.concatenate([self._t_ns[keep], t_ns])
        self._kind = np.concatenate([self._kind[keep], kind])
        self._values = np.concatenate([self._values[keep], values])
        surprises = self._run(len(self._history) - 1)
        self._poses = [p for p in self._poses if p.t_ns > self.newest_ns - self._history_ns]
        return surprises

    def correct(self, pose: PoseMeasurement) -> list[Surprise] | None:
        """Take an external pose, late or early; None when it is older than what is kept."""
        if pose.t_ns <= self._history.oldest_ns:
            return None
        self._poses.append(pose)
        self._poses.sort(key=lambda p: p.t_ns)  # stable: equal times in order of arrival
        if pose.t_ns > self.newest_ns:
            return []
        surprises = self._run(self._history.index_at(pose.t_ns - 1))
        return [s for s in surprises if s.kind == POSE and s.t_ns == pose.t_ns]

    def at(self, t_ns: int) -> PoseState:
        """Return the pose at a time from the oldest state to the newest."""
        index = self._history.index_at(t_ns)
        state = self._history.state(index)
        rows = self._rows(int(state.t_ns[0]), t_ns, ticks=False)
        self._take(state, rows, t_ns, empty_states(0))
        return PoseState(t_ns, _vector(state), state, index)

    def joint(self, earlier: PoseState, later: PoseState) -> Float64Array:
        """Return the (12, 12) covariance of the two poses' vectors."""
        phi = self._phi(earlier, later)
        p0, p1 = earlier.state.p[0], later.state.p[0]
        both = np.block([[p0, p0 @ phi.T], [phi @ p0, p1]])
        twice = np.kron(np.eye(2), POSE_OF_STATE)
        return np.asarray(twice @ both @ twice.T)

    def _phi(self, earlier: PoseState, later: PoseState) -> Float64Array:
        """Return the derivative of the later state's error by the earlier one's."""
        if earlier.index == later.index:
            state, end_ns = earlier.state, later.t_ns
        else:
            state, end_ns = earlier.state, self._history.state(earlier.index + 1).t_ns[0]
        state = copied(state)
        ticks = empty_states(1)
        rows = self._rows(earlier.t_ns, int(end_ns), ticks=earlier.index != later.index)
        self._take(state, rows, int(end_ns), ticks)
        if earlier.index == later.index:
            return np.asarray(state.phi[0], np.float64)
        between = self._history.phi_since(earlier.index + 1, later.index)
        return np.asarray(later.state.phi[0] @ between @ ticks.phi[0], np.float64)

    def _run(self, index: int) -> list[Surprise]:
        """Find the states behind one anew, as far as there are ticks."""
        state = self._history.state(index)
        rows = self._rows(int(state.t_ns[0]), int(self._t_ns[-1]), ticks=True)
        self._history.cut_behind(index)
        room = self._history.room_for(int(np.count_nonzero(rows.kind == TICK)))
        outcome, nis, written = self._take(state, rows, int(rows.t_ns[-1]), room)
        self._history.add(written)
        wrong = (outcome == SURPRISED) | ((outcome == LEFT_OUT) & np.isfinite(nis))
        wrong &= (rows.kind == WHEELS) | (rows.kind == POSE)
        return [
            Surprise(int(rows.t_ns[i]), int(rows.kind[i]), float(nis[i]))
            for i in np.flatnonzero(wrong)
        ]

    def _rows(self, after_ns: int, until_ns: int, *, ticks: bool) -> Rows:
        """Return the rows and poses in (after_ns, until_ns], in order of time and kind."""
        chosen = slice(*np.searchsorted(self._t_ns, [after_ns, until_ns], side="right"))
        t_ns, kind, values = self._t_ns[chosen], self._kind[chosen], self._values[chosen]
        poses = [p for p in self._poses if after_ns < p.t_ns <= until_ns]
        vectors, covariances = np.zeros((len(poses), 6)), np.zeros((len(poses), 6, 6))
        if poses:
            extra = np.zeros((len(poses), COLUMNS))
            for row, pose in enumerate(poses):
                vectors[row], covariances[row] = pose.vector, pose.covariance
                extra[row, :2] = row, float(pose.gated)
            pose_ns = np.array([pose.t_ns for pose in poses], np.int64)
            t_ns = np.concatenate([t_ns, pose_ns])
            kind = np.concatenate([kind, np.full(len(poses), POSE)])
            values = np.concatenate([values, extra])
            order = np.lexsort([kind, t_ns])
            t_ns, kind, values = t_ns[order], kind[order], values[order]
        if not ticks and (kind == TICK).any():
            t_ns, kind, values = (part[kind != TICK] for part in (t_ns, kind, values))
        return Rows(t_ns, kind, values, vectors, covariances)

    def _take(
        self, state: States, rows: Rows, end_ns: int, out: States
    ) -> tuple[Int64Array, Float64Array, int]:
        """Run the kernel: outcome and NIS of every row, and the number of ticks written."""
        outcome, nis = np.zeros(len(rows.t_ns), np.int64), np.zeros(len(rows.t_ns))
        written = run(state, rows, end_ns, self._constants, out, outcome, nis)
        return outcome, nis, int(written)


def _vector(state: States) -> Float64Array:
    """Return x, y, z, roll, pitch, yaw of one state."""
    held = state.held[0]
    vector = POSE_OF_STATE @ state.x[0]
    vector[3] += held[TICK_ROLL] + held[TICK_ROLL_RATE] * held[TICK_SINCE_S]
    vector[4] += held[TICK_PITCH] + held[TICK_PITCH_RATE] * held[TICK_SINCE_S]
    return np.asarray(vector, np.float64)
