"""What the driver wants: forward speed and yaw rate at any moment of a drive.

Time starts when the initial rest is over. Commands are steps; `Ramp` makes of them what a base's
controller lets through.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from simulation.errors import SimulationError
from simulation.vehicle.jackal import MAX_SPEED_M_S, MAX_YAW_RATE_RAD_S


class Twist(NamedTuple):
    """Forward speed (x of the body frame), m/s, and yaw rate, rad/s, counter-clockwise."""

    speed_m_s: float
    yaw_rate_rad_s: float


class PlanarPose(NamedTuple):
    """Where the vehicle truly is, seen from above, in the world."""

    x_m: float
    y_m: float
    yaw_rad: float


STANDSTILL = Twist(0.0, 0.0)
ORIGIN = PlanarPose(0.0, 0.0, 0.0)


class DriveCommands(Protocol):
    """A drive."""

    def twist(self, t_s: float, pose: PlanarPose) -> Twist:
        """Return what is wanted at `t_s` seconds after the rest; called with rising times."""


def _check_speed(speed_m_s: float) -> None:
    """Raise SimulationError unless the vehicle can drive that fast."""
    if not 0.0 < abs(speed_m_s) <= MAX_SPEED_M_S:
        raise SimulationError(
            f"a speed of {speed_m_s} m/s; expected up to {MAX_SPEED_M_S} m/s and not 0"
        )


def _check_positive(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise SimulationError(f"{name} is {value}; expected a finite number above 0")


@dataclass(frozen=True, slots=True)
class Line:
    """Straight ahead; nobody corrects the heading."""

    speed_m_s: float = 0.3

    def __post_init__(self) -> None:
        _check_speed(self.speed_m_s)

    def twist(self, t_s: float, pose: PlanarPose) -> Twist:  # noqa: ARG002 - open loop
        """Return the constant twist."""
        return Twist(self.speed_m_s, 0.0)


@dataclass(frozen=True, slots=True)
class Arc:
    """A circle of that radius; positive turns left."""

    speed_m_s: float = 0.3
    radius_m: float = 2.0

    def __post_init__(self) -> None:
        _check_speed(self.speed_m_s)
        _check_positive("radius_m without its sign", abs(self.radius_m))

    def twist(self, t_s: float, pose: PlanarPose) -> Twist:  # noqa: ARG002 - open loop
        """Return the constant twist."""
        return Twist(self.speed_m_s, self.speed_m_s / self.radius_m)


@dataclass(frozen=True, slots=True)
class SCurve:
    """Swings to the left and to the right of a straight line.

    The yaw is swing_rad sin(2 pi t / period_s) if the vehicle follows, so its rate is the
    derivative of that.
    """

    speed_m_s: float = 0.3
    swing_rad: float = 0.6
    period_s: float = 12.0

    def __post_init__(self) -> None:
        _check_speed(self.speed_m_s)
        _check_positive("period_s", self.period_s)

    def twist(self, t_s: float, pose: PlanarPose) -> Twist:  # noqa: ARG002 - open loop
        """Return constant speed and swinging yaw rate."""
        omega = 2.0 * math.pi / self.period_s
        return Twist(self.speed_m_s, self.swing_rad * omega * math.cos(omega * t_s))


@dataclass(frozen=True, slots=True)
class StopAndGo:
    """Straight ahead for go_s, standing for stop_s, and again."""

    speed_m_s: float = 0.3
    go_s: float = 3.0
    stop_s: float = 2.0

    def __post_init__(self) -> None:
        _check_speed(self.speed_m_s)
        _check_positive("go_s", self.go_s)
        _check_positive("stop_s", self.stop_s)

    def twist(self, t_s: float, pose: PlanarPose) -> Twist:  # noqa: ARG002 - open loop
        """Return the twist of the running period."""
        going = t_s % (self.go_s + self.stop_s) < self.go_s
        return Twist(self.speed_m_s, 0.0) if going else STANDSTILL


class Waypoints:
    """From point to point on the true pose, then standing.

    Steers at the next point: yaw rate = gain * bearing, slower the more it has to turn, and on
    the spot beyond a right angle.

    Args:
        points_m: (x, y) in the world.
        speed_m_s: on the straight.
        reached_m: a point counts as reached at this distance.
        gain_per_s: yaw rate per radian of bearing.
        max_yaw_rate_rad_s: limit of the yaw rate.

    Raises:
        SimulationError: no points, or a number that makes no sense.
    """

    def __init__(
        self,
        points_m: Sequence[tuple[float, float]],
        speed_m_s: float = 0.3,
        reached_m: float = 0.15,
        gain_per_s: float = 1.5,
        max_yaw_rate_rad_s: float = 0.8,
    ) -> None:
        if not points_m or not all(math.isfinite(c) for point in points_m for c in point):
            raise SimulationError("waypoints need at least one (x, y), all finite")
        _check_speed(speed_m_s)
        _check_positive("speed_m_s of waypoints", speed_m_s)
        _check_positive("reached_m", reached_m)
        self._points_m = tuple(points_m)
        self._speed_m_s = speed_m_s
        self._reached_m = reached_m
        self._gain_per_s = gain_per_s
        self._max_yaw_rate_rad_s = max_yaw_rate_rad_s
        self._next = 0

    def twist(self, t_s: float, pose: PlanarPose) -> Twist:
        """Return the twist towards the next point; a drive that starts anew begins at the first."""
        if t_s == 0.0:
            self._next = 0
        while self._next < len(self._points_m):
            x, y = self._points_m[self._next]
            dx, dy = x - pose.x_m, y - pose.y_m
            if math.hypot(dx, dy) > self._reached_m:
                return self._towards(_wrapped(math.atan2(dy, dx) - pose.yaw_rad))
            self._next += 1
        return STANDSTILL

    def skip_within(self, distance_m: float, pose: PlanarPose) -> None:
        """Give up the next points as far as they are nearer than that; the last one stays."""
        while self._next < len(self._points_m) - 1:
            x, y = self._points_m[self._next]
            if math.hypot(x - pose.x_m, y - pose.y_m) >= distance_m:
                return
            self._next += 1

    def _towards(self, bearing_rad: float) -> Twist:
        limit = self._max_yaw_rate_rad_s
        yaw_rate = min(max(self._gain_per_s * bearing_rad, -limit), limit)
        return Twist(self._speed_m_s * max(0.0, math.cos(bearing_rad)), yaw_rate)


def loop(
    start: PlanarPose = ORIGIN,
    radius_m: float = 1.5,
    speed_m_s: float = 0.3,
    laps: int = 1,
) -> Waypoints:
    """Return a circle to the left that comes back to the start, closed on the true pose."""
    _check_positive("radius_m", radius_m)
    if laps < 1:
        raise SimulationError(f"{laps} laps; expected 1 or more")
    centre_x = start.x_m - radius_m * math.sin(start.yaw_rad)
    centre_y = start.y_m + radius_m * math.cos(start.yaw_rad)
    parts = max(12, math.ceil(2.0 * math.pi * radius_m / 0.4))
    angles = [start.yaw_rad + 2.0 * math.pi * (i + 1) / parts for i in range(parts * laps)]
    points = [
        (centre_x + radius_m * math.sin(a), centre_y - radius_m * math.cos(a)) for a in angles
    ]
    return Waypoints(points, speed_m_s)


def _wrapped(angle_rad: float) -> float:
    return math.remainder(angle_rad, 2.0 * math.pi)


class Ramp:
    """Lets a twist through no faster than a base's controller does.

    Args:
        acceleration_m_s2: limit of the change of speed; Jackal's own is 20, which no operator uses.
        yaw_acceleration_rad_s2: limit of the change of yaw rate.
    """

    def __init__(
        self, acceleration_m_s2: float = 0.5, yaw_acceleration_rad_s2: float = 1.5
    ) -> None:
        _check_positive("acceleration_m_s2", acceleration_m_s2)
        _check_positive("yaw_acceleration_rad_s2", yaw_acceleration_rad_s2)
        self._limits = (acceleration_m_s2, yaw_acceleration_rad_s2)
        self._twist = STANDSTILL

    def step(self, wanted: Twist, dt_s: float) -> Twist:
        """Return the twist after `dt_s` on the way to the wanted one, within the base's limits."""
        largest = (MAX_SPEED_M_S, MAX_YAW_RATE_RAD_S)
        new = []
        for now, goal, change, most in zip(self._twist, wanted, self._limits, largest, strict=True):
            goal_inside = min(max(goal, -most), most)
            new.append(now + min(max(goal_inside - now, -change * dt_s), change * dt_s))
        self._twist = Twist(*new)
        return self._twist
