"""Skid-steer kinematics against worked numbers and its own inverse."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.wheels.skid_steer import rim_speeds, twist, twist_sigmas

SPEEDS = st.floats(-3.0, 3.0)
TRACKS = st.floats(0.1, 2.0)


def test_jackal_turning_on_the_spot() -> None:
    # Clearpath Jackal: track 0.37559 m, effective 1.5 x that. Rims at -+0.5 m/s turn it at
    # 1 m/s / 0.563385 m = 1.774985 rad/s, not at the geometric 2.662478 rad/s.
    assert twist(-0.5, 0.5, 1.5 * 0.37559) == pytest.approx((0.0, 1.7749851))


def test_left_turn_is_positive() -> None:
    speed_m_s, yaw_rate_rad_s = twist(0.8, 1.0, 0.5)
    assert (speed_m_s, yaw_rate_rad_s) == pytest.approx((0.9, 0.4))


@given(SPEEDS, SPEEDS, TRACKS)
def test_rim_speeds_invert_the_twist(left: float, right: float, track_e_m: float) -> None:
    speed_m_s, yaw_rate_rad_s = twist(left, right, track_e_m)
    assert rim_speeds(speed_m_s, yaw_rate_rad_s, track_e_m) == pytest.approx(
        (left, right), abs=1e-12
    )


@given(SPEEDS, TRACKS)
def test_equal_sides_drive_straight(speed: float, track_e_m: float) -> None:
    assert twist(speed, speed, track_e_m) == (speed, 0.0)


@given(SPEEDS, SPEEDS, TRACKS)
def test_swapping_the_sides_turns_the_other_way(left: float, right: float, track: float) -> None:
    speed_m_s, yaw_rate_rad_s = twist(left, right, track)
    assert twist(right, left, track) == pytest.approx((speed_m_s, -yaw_rate_rad_s))


def test_sigmas_are_those_of_a_sampled_vehicle() -> None:
    dice = random.Random(4)
    track_e_m, rim_sigma, track_ratio = 0.56, 0.02, 0.05
    left, right = 0.1, 0.9
    drawn = [
        twist(
            dice.gauss(left, rim_sigma),
            dice.gauss(right, rim_sigma),
            track_e_m * dice.gauss(1.0, track_ratio),
        )
        for _ in range(20_000)
    ]
    _, yaw_rate = twist(left, right, track_e_m)
    speed_sigma, yaw_sigma = twist_sigmas(yaw_rate, rim_sigma, track_e_m, track_ratio)
    for index, sigma in enumerate((speed_sigma, yaw_sigma)):
        values = [sample[index] for sample in drawn]
        mean = sum(values) / len(values)
        spread = math.sqrt(sum((v - mean) ** 2 for v in values) / len(values))
        assert spread == pytest.approx(sigma, rel=0.03)
