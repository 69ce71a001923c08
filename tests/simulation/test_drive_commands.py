import math
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulation.errors import SimulationError
from simulation.vehicle.backing_off import BackingOff
from simulation.vehicle.drive_commands import (
    ORIGIN,
    STANDSTILL,
    Arc,
    DriveCommands,
    Line,
    PlanarPose,
    Ramp,
    SCurve,
    StopAndGo,
    Twist,
    Waypoints,
    loop,
)


def follow(commands: DriveCommands, seconds: float, start: PlanarPose) -> list[PlanarPose]:
    """Poses of a vehicle that does exactly what is commanded."""
    pose, poses, dt = start, [start], 0.02
    for i in range(round(seconds / dt)):
        speed, yaw_rate = commands.twist(i * dt, pose)
        yaw = pose.yaw_rad + yaw_rate * dt / 2
        pose = PlanarPose(
            pose.x_m + speed * dt * math.cos(yaw),
            pose.y_m + speed * dt * math.sin(yaw),
            pose.yaw_rad + yaw_rate * dt,
        )
        poses.append(pose)
    return poses


def test_line_and_arc() -> None:
    assert follow(Line(0.5), 4.0, ORIGIN)[-1] == pytest.approx((2.0, 0.0, 0.0))
    quarter = follow(Arc(0.5, -2.0), math.pi / 0.5, ORIGIN)[-1]
    assert quarter == pytest.approx((2.0, -2.0, -math.pi / 2), abs=0.02)


def test_an_s_curve_swings_and_comes_back() -> None:
    yaws = [pose.yaw_rad for pose in follow(SCurve(0.3, 0.6, 12.0), 12.0, ORIGIN)]
    assert (max(yaws), min(yaws), yaws[-1]) == pytest.approx((0.6, -0.6, 0.0), abs=0.01)


def test_stop_and_go() -> None:
    drive = StopAndGo(0.3, 3.0, 2.0)
    assert [drive.twist(t, ORIGIN).speed_m_s for t in (0.0, 2.9, 3.1, 4.9, 5.1)] == [
        0.3,
        0.3,
        0.0,
        0.0,
        0.3,
    ]


def test_waypoints_are_reached_in_their_order_and_it_stops_at_the_last() -> None:
    points = [(1.0, 0.5), (0.0, 1.5), (-0.5, 0.0)]
    drive = Waypoints(points)
    poses = follow(drive, 40.0, ORIGIN)
    when = [min(range(len(poses)), key=lambda i: math.dist(poses[i][:2], p)) for p in points]
    assert when == sorted(when)
    assert all(math.dist(poses[i][:2], p) < 0.16 for i, p in zip(when, points, strict=True))
    assert drive.twist(40.0, poses[-1]) == STANDSTILL
    assert follow(drive, 40.0, ORIGIN) == poses  # a drive can be used again


def test_a_loop_comes_back_to_its_start() -> None:
    start = PlanarPose(1.0, 2.0, 0.7)
    poses = follow(loop(start, 1.5, 0.4), 40.0, start)
    assert math.dist(poses[-1][:2], start[:2]) < 0.2
    centre = (1.0 - 1.5 * math.sin(0.7), 2.0 + 1.5 * math.cos(0.7))
    assert all(1.3 < math.dist(p[:2], centre) < 1.6 for p in poses)
    assert poses[-1].yaw_rad == pytest.approx(0.7 + 2 * math.pi, abs=0.4)


@given(
    st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9)), min_size=2, max_size=20),
    st.floats(0.001, 0.1),
)
def test_a_ramp_bounds_change_and_value(wanted: list[tuple[float, float]], dt_s: float) -> None:
    ramp, before = Ramp(0.5, 1.5), STANDSTILL
    for goal in wanted:
        now = ramp.step(Twist(*goal), dt_s)
        assert abs(now.speed_m_s - before.speed_m_s) <= 0.5 * dt_s * (1 + 1e-9)
        assert abs(now.yaw_rate_rad_s - before.yaw_rate_rad_s) <= 1.5 * dt_s * (1 + 1e-9)
        assert abs(now.speed_m_s) <= 2.0
        assert abs(now.yaw_rate_rad_s) <= 4.0
        before = now


def test_a_ramp_arrives() -> None:
    ramp = Ramp()
    for _ in range(100):
        now = ramp.step(Twist(0.3, -0.5), 0.02)
    assert now == pytest.approx((0.3, -0.5))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Line(0.0), "speed of 0.0"),
        (lambda: Line(3.0), "speed of 3.0"),
        (lambda: Line(math.nan), "speed of nan"),
        (lambda: Arc(0.3, 0.0), "radius_m"),
        (lambda: SCurve(period_s=0.0), "period_s"),
        (lambda: StopAndGo(go_s=-1.0), "go_s"),
        (lambda: Waypoints([]), "at least one"),
        (lambda: Waypoints([(math.inf, 0.0)]), "finite"),
        (lambda: Waypoints([(1.0, 0.0)], speed_m_s=-0.3), "speed_m_s of waypoints"),
        (lambda: loop(laps=0), "0 laps"),
        (lambda: loop(radius_m=-1.0), "radius_m"),
        (lambda: Ramp(acceleration_m_s2=0.0), "acceleration_m_s2"),
    ],
)
def test_drives_that_cannot_be_driven(make: Callable[[], object], message: str) -> None:
    with pytest.raises(SimulationError, match=message):
        make()


def blocked(pose: PlanarPose) -> bool:
    """Tell whether a rock at (1.5, 0), 0.5 m wide, stops a vehicle there that looks ahead."""
    return 1.0 < pose.x_m < 2.0 and abs(pose.y_m) < 0.25


def drive_around_a_rock(commands: DriveCommands, seconds: float) -> list[PlanarPose]:
    """Poses of a vehicle that comes no nearer to the rock than 0.5 m and 0.25 m aside."""
    pose, poses, dt = ORIGIN, [ORIGIN], 0.02
    for i in range(round(seconds / dt)):
        speed, yaw_rate = commands.twist(i * dt, pose)
        ahead = PlanarPose(
            pose.x_m + speed * dt * math.cos(pose.yaw_rad),
            pose.y_m + speed * dt * math.sin(pose.yaw_rad),
            pose.yaw_rad + yaw_rate * dt,
        )
        if blocked(ahead):
            ahead = PlanarPose(pose.x_m, pose.y_m, ahead.yaw_rad)
        pose = ahead
        poses.append(pose)
    return poses


def test_what_sticks_backs_off_and_gets_past() -> None:
    points = [(0.5 * i, 0.0) for i in range(1, 9)]
    stubborn = drive_around_a_rock(Waypoints(points), 60.0)
    assert stubborn[-1].x_m < 1.01
    drive = BackingOff(Waypoints(points))
    for _ in range(2):  # the same again from the start
        poses = drive_around_a_rock(drive, 60.0)
        assert math.hypot(poses[-1].x_m - 4.0, poses[-1].y_m) < 0.2
        assert not any(map(blocked, poses))


def test_what_does_not_stick_is_driven_by_its_points_alone() -> None:
    points = [(1.0, 0.0), (1.0, 2.0), (-1.0, 2.0), (0.0, 0.0)]
    alone = follow(Waypoints(points), 40.0, ORIGIN)
    assert follow(BackingOff(Waypoints(points)), 40.0, ORIGIN) == alone


def test_points_that_are_near_are_skipped_but_never_the_last() -> None:
    way = Waypoints([(0.5, 0.0), (1.0, 0.0), (0.0, 2.0), (0.2, 0.0)])
    way.skip_within(1.2, ORIGIN)
    assert way.twist(1.0, ORIGIN).yaw_rate_rad_s > 0.0
    way.skip_within(9.0, ORIGIN)
    assert way.twist(1.0, ORIGIN).speed_m_s == pytest.approx(0.3)
