"""What may go wrong on the way: no NaN, uncertainty that grows as it must, and a word about it."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.samples import AccelerationSample, Sample, WheelTwistSample, YawRateSample
from mapping.ego_motion.ego_motion import EgoMotion
from mapping.ego_motion.settings import EgoMotionSettings
from mapping.errors import MappingError
from mapping.geometry import Float64Array, RigidTransform, UncertainPose
from tests.mapping.ego_motion.drives import START_NS, Drive, cut, in_order, replay, stop_and_go

NO_DELAY = EgoMotionSettings(
    gyro_delay_s=0.0, wheels_delay_s=0.0, acceleration_delay_s=0.0, vibration_delay_s=0.0
)


def followed(
    samples: Sequence[Sample], settings: EgoMotionSettings = NO_DELAY, step_s: float = 0.1
) -> tuple[dict[float, UncertainPose], EgoMotion]:
    """Return the poses by seconds; all of them finite, all covariances sound."""
    ego = EgoMotion(settings)
    poses = {round(seconds, 3): pose for seconds, pose in replay(ego, samples, step_s)}
    for pose in poses.values():
        assert np.isfinite(pose.transform.translation_m).all()
        assert np.isfinite(pose.covariance).all()
        assert np.linalg.eigvalsh(pose.covariance).min() > -1e-12
    return poses, ego


def yaw_sigma(pose: UncertainPose) -> float:
    return float(pose.covariance[5, 5] ** 0.5)


def within(poses: dict[float, UncertainPose], drive: Drive, seconds: float, sigmas: float) -> bool:
    """Tell whether x and y are within so many sigmas of the truth, plus 10 mm."""
    pose, true = poses[seconds], drive.truth(np.array([seconds]))[0]
    error = np.abs(pose.transform.translation_m[:2] - true[:2])
    return bool((error < sigmas * np.sqrt(pose.covariance.diagonal()[:2]) + 0.01).all())


@pytest.fixture(scope="module")
def clean() -> dict[float, UncertainPose]:
    return followed(Drive().samples())[0]


def test_a_gyro_that_is_unplugged_for_five_seconds(clean: dict[float, UncertainPose]) -> None:
    drive = Drive()
    rates = cut(drive.rates(), 3.0, 8.0)
    poses, ego = followed(in_order(drive.acceleration(), rates, drive.wheels()))
    assert [event.kind for event in ego.events] == ["gyro_lost", "gyro_back"]
    assert yaw_sigma(poses[7.0]) > 5.0 * yaw_sigma(clean[7.0])
    assert within(poses, drive, 11.5, 3.0)
    alone, _ = followed(in_order(drive.acceleration(), rates))
    assert yaw_sigma(alone[7.0]) > yaw_sigma(poses[7.0])


def test_wheels_stuck_at_zero_while_moving(clean: dict[float, UncertainPose]) -> None:
    drive = Drive()
    wheels = [
        replace(w, speed_m_s=0.0, yaw_rate_rad_s=0.0) if 3.0 < second(w) < 5.0 else w
        for w in drive.wheels()
    ]
    poses, ego = followed(in_order(drive.acceleration(), drive.rates(), wheels))
    assert "wheels_stuck" in [event.kind for event in ego.events]
    assert poses[5.0].covariance[0, 0] > 4.0 * clean[5.0].covariance[0, 0]
    assert within(poses, drive, 5.5, 3.0)


def test_wheels_that_slip_by_half_for_two_seconds(clean: dict[float, UncertainPose]) -> None:
    drive = Drive()
    wheels = [
        replace(w, speed_m_s=2.0 * w.speed_m_s) if 3.0 < second(w) < 5.0 else w
        for w in drive.wheels()
    ]
    poses, ego = followed(in_order(drive.acceleration(), drive.rates(), wheels))
    assert "wheels_slip" in [event.kind for event in ego.events]
    assert poses[5.0].covariance[0, 0] > 4.0 * clean[5.0].covariance[0, 0]
    assert within(poses, drive, 5.5, 3.0)


def test_a_shock_of_three_g_is_told_and_does_not_tilt(clean: dict[float, UncertainPose]) -> None:
    drive = Drive()
    shaken: list[Sample] = []
    for sample in drive.acceleration():
        force = sample.acceleration_m_s2
        if 4.0 < second(sample) < 4.01:
            force = force + np.array([3.0 * 9.81, 0.0, 0.0])
        shaken.append(AccelerationSample(sample.t_ns, force, sample.sequence))
    poses, ego = followed(in_order(shaken, drive.rates(), drive.wheels()))
    assert [event.kind for event in ego.events] == ["shock"]
    apart = poses[4.0].transform.rotation.T @ clean[4.0].transform.rotation
    assert np.abs(apart - np.eye(3)).max() < 0.01
    assert within(poses, drive, 5.5, 3.0)


def test_stamps_out_of_order_by_200_ms_change_nothing(clean: dict[float, UncertainPose]) -> None:
    shuffler = random.Random(1)
    mixed = Drive().samples()
    arrival = {id(s): s.t_ns + shuffler.randrange(200_000_000) for s in mixed}
    mixed.sort(key=lambda sample: arrival[id(sample)])
    poses, ego = followed(mixed)
    assert not ego.events
    # But for rounding: batches are cut elsewhere.
    for seconds in (3.0, 7.0, 11.0):
        found, expected = poses[seconds], clean[seconds]
        np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-9, atol=1e-18)
        np.testing.assert_allclose(
            found.transform.translation_m, expected.transform.translation_m, rtol=1e-9, atol=1e-12
        )


def unplugged(drive: Drive) -> list[Sample]:
    return in_order(drive.acceleration(), cut(drive.rates(), 3.0, 8.0), drive.wheels())


def stuck(drive: Drive) -> list[Sample]:
    return with_wheels(drive, 0.0, 0.0)


def slipping(drive: Drive) -> list[Sample]:
    return with_wheels(drive, 2.0, 1.0)


def with_wheels(drive: Drive, speed: float, turn: float) -> list[Sample]:
    """Return samples whose wheels say so many times as much from 3 to 5 s."""
    wheels = [
        replace(w, speed_m_s=speed * w.speed_m_s, yaw_rate_rad_s=turn * w.yaw_rate_rad_s)
        if 3.0 < second(w) < 5.0
        else w
        for w in drive.wheels()
    ]
    return in_order(drive.acceleration(), drive.rates(), wheels)


def shaken(drive: Drive) -> list[Sample]:
    push = np.array([3.0 * 9.81, 0.0, 0.0])
    force = [
        AccelerationSample(s.t_ns, s.acceleration_m_s2 + push, s.sequence)
        if 4.0 < second(s) < 4.01
        else s
        for s in drive.acceleration()
    ]
    return in_order(force, drive.rates(), drive.wheels())


def shuffled(drive: Drive) -> list[Sample]:
    shuffler = random.Random(drive.seed)
    arrival = [(s.t_ns + shuffler.randrange(200_000_000), s) for s in drive.samples()]
    return [sample for _, sample in sorted(arrival, key=lambda pair: pair[0])]


class SpinsInPlace(Drive):
    """From 3 to 5 s the wheels of one side dig in: they turn, the rover does not."""

    def speed(self, t: Float64Array) -> Float64Array:
        return np.where((t > 3.0) & (t < 5.0), 0.0, super().speed(t))

    def wheels(self) -> list[WheelTwistSample]:
        return [
            replace(w, speed_m_s=0.3, yaw_rate_rad_s=0.8) if 3.0 < second(w) < 5.0 else w
            for w in super().wheels()
        ]


@pytest.mark.parametrize(
    ("fault", "kind"),
    [
        (unplugged, Drive),
        (stuck, Drive),
        (slipping, Drive),
        (shaken, Drive),
        (shuffled, Drive),
        (Drive.samples, SpinsInPlace),
    ],
)
def test_after_a_fault_the_error_is_that_of_the_stated_sigma(
    fault: Callable[[Drive], list[Sample]], kind: type[Drive]
) -> None:
    """Over drives of different noise, wheel scale and gyro bias."""
    squares = []
    for seed, scale in ((2, -0.03), (4, 0.04)):
        drive = kind(seed=seed, scale=scale, bias_rad_s=0.005 * seed)
        poses, _ = followed(fault(drive), step_s=0.5)
        squares += [normalised(poses[t], drive, t) ** 2 for t in (5.5, 7.5, 11.5)]
    assert np.max(squares) < 3.5**2
    assert np.mean(squares) < 2.0


def normalised(pose: UncertainPose, drive: Drive, seconds: float) -> Float64Array:
    """Return the errors of x, y and yaw over their sigmas."""
    yaw = np.arctan2(pose.transform.rotation[1, 0], pose.transform.rotation[0, 0])
    found = np.array([*pose.transform.translation_m[:2], yaw])
    error = found - drive.truth(np.array([seconds]))[0]
    return np.asarray(error / np.sqrt(pose.covariance.diagonal()[[0, 1, 5]]), np.float64)


def test_wheels_that_turn_the_rover_otherwise_than_the_gyro_are_doubted() -> None:
    drive = SpinsInPlace()
    poses, ego = followed(drive.samples(), step_s=0.5)
    assert "wheels_slip" in [event.kind for event in ego.events]
    # 0.6 m of wheels, none of it driven: at least half of it is doubt.
    assert poses[5.5].covariance[0, 0] ** 0.5 > 0.15


def test_a_sample_that_is_too_late_is_left_out_and_told() -> None:
    samples = Drive(seconds=4.0).samples()
    late = next(s for s in samples if isinstance(s, YawRateSample) and second(s) > 2.0)
    _, ego = followed([*samples, late])
    assert [event.kind for event in ego.events] == ["late_sample"]


def test_nonsense_is_left_out_and_told() -> None:
    drive = Drive(seconds=4.0)
    bad = YawRateSample(START_NS + 2_000_000_001, float("nan"), None, None, 0)
    future = YawRateSample(START_NS + 10**15, 0.0, None, None, 0)
    samples = in_order(drive.samples(), [bad])
    _, ego = followed([*samples[:-100], future, *samples[-100:]])
    assert {event.kind for event in ego.events} == {"bad_sample", "clock_jump"}


def test_a_pause_of_an_hour_is_survived() -> None:
    drive = Drive(seconds=3.0)
    later = [replace(s, t_ns=s.t_ns + 3600 * 10**9) for s in drive.samples()]
    ego = EgoMotion(NO_DELAY)
    for sample in [*drive.samples(), *later]:
        ego.add(sample)
    ego.finish()
    end_ns = ego.poses_ready_until_ns
    assert end_ns is not None
    assert end_ns > later[-1].t_ns - 10**8
    pose = ego.pose_at(end_ns)
    assert pose is not None
    assert np.isfinite(pose.covariance).all()


def test_without_wheels_the_way_is_found_within_its_sigma() -> None:
    drive = Drive()
    poses, _ = followed(in_order(drive.acceleration(), drive.rates()))
    assert within(poses, drive, 11.5, 3.0)
    assert 0.05 < poses[11.5].covariance[0, 0] ** 0.5 < 1.5


def test_accelerations_that_stop_leave_the_tilt_unknown() -> None:
    drive = Drive()
    force = cut(drive.acceleration(), 4.0, 8.0)
    poses, ego = followed(in_order(force, drive.rates(), drive.wheels()))
    assert [event.kind for event in ego.events] == ["acceleration_lost", "acceleration_back"]
    assert poses[7.0].covariance[3, 3] ** 0.5 > 0.15
    assert poses[9.0].covariance[3, 3] ** 0.5 < 0.03


@pytest.mark.parametrize(
    "change",
    [
        {"tick_s": 0.5},
        {"gyro_noise_rad_s_per_sqrt_hz": 0.0},
        {"still_ratio": 2.0},
        {"history_s": 0.1},
        {"pose_gate_probability": 1.5},
        {"slip": float("nan")},
    ],
)
def test_settings_that_cannot_be_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(MappingError, match=next(iter(change))):
        replace(EgoMotionSettings(), **change)  # type: ignore[arg-type] # one of many types


def second(sample: Sample) -> float:
    return (sample.t_ns - START_NS) * 1e-9


def test_wheel_samples_are_what_was_meant() -> None:
    """The helper's slip must meet moving wheels, or the tests above show nothing."""
    moving = [w for w in Drive().wheels() if 3.0 < second(w) < 5.0]
    assert all(isinstance(w, WheelTwistSample) and w.speed_m_s > 0.2 for w in moving)


@dataclass
class Sunken(Drive):
    """A rover that digs itself in: it stands from 3 s to 6 s, while its wheels turn on."""

    def speed(self, t: Float64Array) -> Float64Array:
        return np.where((t > 3.0) & (t < 6.0), 0.0, stop_and_go(t))

    def wheels(self) -> list[WheelTwistSample]:
        return Drive(self.seconds, self.seed).wheels()


def test_poses_hold_a_rover_whose_wheels_spin_in_place() -> None:
    """Between poses it goes no farther than wheels can drive, then and when they grip again."""
    drive, rng = Sunken(seed=2), np.random.default_rng(2)
    ego = EgoMotion(NO_DELAY)
    worst_m = 0.0
    for seconds, pose in replay(ego, drive.samples()):
        x, y, yaw = drive.truth(np.array([seconds]))[0]
        worst_m = max(worst_m, float(np.hypot(*(pose.transform.translation_m[:2] - (x, y)))))
        turn = Rotation.from_euler("z", yaw).as_matrix()
        place = np.array([x, y, 0.0]) + 0.003 * rng.standard_normal(3)
        seen = RigidTransform(turn, place)
        assert ego.correct(pose.t_ns, seen, np.diag([9e-6] * 6), gated=False)
    assert worst_m < 0.3 * 0.1 + 0.015
