"""How the vehicle truly moved, every millisecond."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float64Array = NDArray[np.float64]
Int64Array = NDArray[np.int64]

STEP_NS = 1_000_000
# 2026-01-01 00:00 UTC: simulated stamps look like recorded ones, and never depend on the clock.
START_NS = 1_767_225_600_000_000_000
_STUCK_STEPS = 5000
_STUCK_WAY_M, _STUCK_M = 0.5, 0.1


@dataclass(frozen=True, slots=True)
class Motion:
    """The truth of a drive; row k is k milliseconds after its start.

    The body frame R is that of `simulation.vehicle.jackal`; the world has z up.

    Attributes:
        start_ns: time of row 0.
        position_m: (N, 3) origin of R in the world.
        quat_wxyz: (N, 4) rotation from R to the world.
        velocity_m_s: (N, 3) of the origin, world axes.
        body_rate_rad_s: (N, 3) angular velocity in R's axes.
        acceleration_m_s2: (N, 3) specific force at the accelerometer in R's axes, mean over the
            millisecond that ends with the row.
        wheel_rate_rad_s: (N, 4) front left, rear left, front right, rear right.
        command: (N, 2) speed (m/s) and yaw rate (rad/s) that the base was told, after its ramp.
    """

    start_ns: int
    position_m: Float64Array
    quat_wxyz: Float64Array
    velocity_m_s: Float64Array
    body_rate_rad_s: Float64Array
    acceleration_m_s2: Float64Array
    wheel_rate_rad_s: Float64Array
    command: Float64Array

    @property
    def duration_ns(self) -> int:
        """Return the time from the first row to the last."""
        return (len(self.position_m) - 1) * STEP_NS

    @property
    def stuck_s(self) -> float:
        """Return how long the vehicle stood although it should drive, seconds.

        Counts the moments at whose end 0.5 m or more were commanded in 5 s, ahead or back, and
        the vehicle came less than 0.1 m far.
        """
        if len(self.position_m) <= _STUCK_STEPS:
            return 0.0
        commanded_m = np.cumsum(np.abs(self.command[:, 0])) * (STEP_NS * 1e-9)
        way_m = commanded_m[_STUCK_STEPS:] - commanded_m[:-_STUCK_STEPS]
        moved = self.position_m[_STUCK_STEPS:] - self.position_m[:-_STUCK_STEPS]
        stuck = (way_m >= _STUCK_WAY_M) & (np.linalg.norm(moved, axis=1) < _STUCK_M)
        return float(np.count_nonzero(stuck)) * STEP_NS * 1e-9

    def elapsed_s(self, t_ns: Int64Array) -> Float64Array:
        """Return times after the start, seconds."""
        return np.asarray((t_ns - self.start_ns) * 1e-9, np.float64)

    def pose_at(self, t_ns: Int64Array) -> tuple[Float64Array, Float64Array]:
        """Return (M, 3) positions and (M, 4) unit quaternions at times within the drive."""
        elapsed = t_ns - self.start_ns
        quat = _interpolated(elapsed, self.quat_wxyz)
        quat /= np.linalg.norm(quat, axis=1, keepdims=True)
        return _interpolated(elapsed, self.position_m), quat

    def mean_acceleration(self, edges_ns: Int64Array) -> Float64Array:
        """Return (M, 3) mean specific forces between M + 1 times, as `acceleration_m_s2`."""
        steps = self.acceleration_m_s2.copy()
        steps[0] = 0.0
        return self._mean(np.cumsum(steps, axis=0), edges_ns)

    def mean_body_rate(self, edges_ns: Int64Array) -> Float64Array:
        """Return (M, 3) mean angular velocities between M + 1 times, as `body_rate_rad_s`."""
        steps = np.zeros_like(self.body_rate_rad_s)
        steps[1:] = (self.body_rate_rad_s[1:] + self.body_rate_rad_s[:-1]) / 2.0
        return self._mean(np.cumsum(steps, axis=0), edges_ns)

    def wheel_rates_at(self, t_ns: Int64Array) -> Float64Array:
        """Return (M, 4) rates of the wheels, as `wheel_rate_rad_s`."""
        return _interpolated(t_ns - self.start_ns, self.wheel_rate_rad_s)

    def wheel_angles_at(self, t_ns: Int64Array) -> Float64Array:
        """Return (M, 4) angles that the wheels have turned since the start, radians."""
        angles = np.cumsum(self.wheel_rate_rad_s, axis=0) * (STEP_NS * 1e-9)
        return _interpolated(t_ns - self.start_ns, angles)

    def _mean(self, summed: Float64Array, edges_ns: Int64Array) -> Float64Array:
        """Return means from sums over the milliseconds."""
        at_edges = _interpolated(edges_ns - self.start_ns, summed)
        return np.diff(at_edges, axis=0) / (np.diff(edges_ns)[:, np.newaxis] / STEP_NS)


def _interpolated(elapsed_ns: Int64Array, rows: Float64Array) -> Float64Array:
    """Return rows at times after the start, linear between the milliseconds."""
    row, rest = np.divmod(elapsed_ns, STEP_NS)
    following = np.minimum(row + 1, len(rows) - 1)
    share = (rest / STEP_NS)[:, np.newaxis]
    return np.asarray(rows[row] * (1.0 - share) + rows[following] * share, np.float64)
