"""What a driver does when the vehicle sticks on a rock: back off, and try beside it."""

from __future__ import annotations

import math

from simulation.vehicle.drive_commands import ORIGIN, PlanarPose, Twist, Waypoints

# Stuck: so much way was commanded without the vehicle having come so far from where it was.
_COMMANDED_M = 1.0
_PROGRESS_M = 0.15
_REVERSE_M_S, _REVERSE_S = -0.3, 3.0
# Then aside, longer with every second attempt, and past the points that are too near to turn to.
_ASIDE_M_S, _ASIDE_RAD_S, _TURN_S, _ASIDE_S = 0.2, 0.6, 2.0, 2.0
_SKIPPED_M = 1.2


class BackingOff:
    """Follows waypoints; where the vehicle sticks it goes back, to one side, and on.

    The first attempt goes to the left, the next one to the right, and so on. A vehicle that is
    not stuck is driven as by the waypoints alone.

    Args:
        way: what is followed.
    """

    def __init__(self, way: Waypoints) -> None:
        self._way = way
        self._attempts = 0
        self._freed_s = self._last_s = 0.0
        self._from = ORIGIN
        self._commanded_m = 0.0

    def twist(self, t_s: float, pose: PlanarPose) -> Twist:
        """Return what is wanted; a drive that starts anew begins at the first point."""
        if t_s == 0.0:
            self._attempts = 0
            self._freed_s = self._last_s = 0.0
            self._watch_from(pose)
        elapsed_s, self._last_s = t_s - self._last_s, t_s
        if t_s < self._freed_s:
            return self._manoeuvre(self._freed_s - t_s)
        if math.hypot(pose.x_m - self._from.x_m, pose.y_m - self._from.y_m) > _PROGRESS_M:
            self._watch_from(pose)
        wanted = self._way.twist(t_s, pose)
        self._commanded_m += abs(wanted.speed_m_s) * elapsed_s
        if self._commanded_m > _COMMANDED_M:
            self._attempts += 1
            self._freed_s = t_s + self._length_s()
            self._way.skip_within(_SKIPPED_M, pose)
            self._watch_from(pose)
        return wanted

    def _watch_from(self, pose: PlanarPose) -> None:
        self._from = pose
        self._commanded_m = 0.0

    def _aside_s(self) -> float:
        return _ASIDE_S * ((self._attempts + 1) // 2)

    def _length_s(self) -> float:
        return _REVERSE_S + _TURN_S + self._aside_s()

    def _manoeuvre(self, left_s: float) -> Twist:
        """Return what is wanted that long before the manoeuvre's end."""
        if left_s > _TURN_S + self._aside_s():
            return Twist(_REVERSE_M_S, 0.0)
        if left_s > self._aside_s():
            return Twist(0.0, _ASIDE_RAD_S if self._attempts % 2 else -_ASIDE_RAD_S)
        return Twist(_ASIDE_M_S, 0.0)
