import numpy as np
import pytest

from tests.simulation.motions import START_NS, motion


def test_positions_between_milliseconds() -> None:
    x = np.arange(101) * 0.001
    drive = motion(0.1, position_m=np.column_stack([x, -x, 0 * x]))
    times = START_NS + np.array([0, 1_500_000, 100_000_000])
    position, quat = drive.pose_at(times)
    np.testing.assert_allclose(position[:, 0], [0.0, 0.0015, 0.1], atol=1e-12)
    np.testing.assert_allclose(quat, [[1.0, 0.0, 0.0, 0.0]] * 3)
    assert drive.elapsed_s(times) == pytest.approx([0.0, 0.0015, 0.1])


def test_quaternions_between_milliseconds_are_unit() -> None:
    drive = motion(0.002)
    drive.quat_wxyz[1] = [np.cos(0.05), 0.0, 0.0, np.sin(0.05)]
    _, between = drive.pose_at(np.array([START_NS + 500_000]))
    np.testing.assert_allclose(between[0], [np.cos(0.025), 0.0, 0.0, np.sin(0.025)], atol=1e-6)


def test_means_hold_what_the_milliseconds_held() -> None:
    random = np.random.default_rng(3)
    acceleration = random.standard_normal((1001, 3))
    drive = motion(1.0, acceleration_m_s2=acceleration)
    exact = drive.mean_acceleration(START_NS + 1_000_000 * np.arange(1001))
    np.testing.assert_allclose(exact, acceleration[1:], atol=1e-9)
    edges = START_NS + np.array([0, 250_400_000, 777_700_000, 1_000_000_000])
    means = drive.mean_acceleration(edges)
    total = (means * np.diff(edges)[:, np.newaxis]).sum(axis=0) * 1e-6
    np.testing.assert_allclose(total, acceleration[1:].sum(axis=0), atol=1e-9)


def test_the_mean_rate_is_the_angle_over_the_time() -> None:
    t = np.arange(1001) * 1e-3
    rate = np.zeros((1001, 3))
    rate[:, 2] = np.cos(7.0 * t)
    edges = START_NS + np.array([100_000_000, 350_000_000, 900_000_000])
    means = motion(1.0, body_rate_rad_s=rate).mean_body_rate(edges)
    angle = np.diff(np.sin(7.0 * np.array([0.1, 0.35, 0.9])) / 7.0)
    np.testing.assert_allclose(means[:, 2], angle / [0.25, 0.55], atol=1e-5)


def test_wheels_turn_by_the_sum_of_their_rates() -> None:
    drive = motion(2.0, wheel_rate_rad_s=(1.0, 2.0, 3.0, -4.0))
    angles = drive.wheel_angles_at(np.array([START_NS + 500_000_000, START_NS + 1_500_000_000]))
    np.testing.assert_allclose(np.diff(angles, axis=0)[0], [1.0, 2.0, 3.0, -4.0])


def test_a_vehicle_that_is_told_to_go_and_does_not_is_stuck() -> None:
    seconds = np.arange(20_001) * 1e-3
    # It drives at 0.3 m/s but for the time from 4 to 12 s.
    x_m = 0.3 * (np.minimum(seconds, 4.0) + np.maximum(seconds - 12.0, 0.0))
    position = np.column_stack([x_m, 0.0 * x_m, 0.0 * x_m])
    command = np.tile([0.3, 0.0], (seconds.size, 1))
    # Of the five seconds before, 0.1 m = 0.33 s may have been driving at either end.
    stuck = motion(20.0, position_m=position, command=command)
    assert stuck.stuck_s == pytest.approx(3.0 + 2 * 0.333, abs=0.01)
    resting = motion(20.0, position_m=position, command=0.0 * command)
    assert resting.stuck_s == 0.0
    assert motion(4.0, command=command[:4001]).stuck_s == 0.0
