"""The filter's derivatives, late poses, and covariances between times."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from mapping.ego_motion.ego_motion import EgoMotion
from mapping.ego_motion.filter_kernels import run
from mapping.ego_motion.filter_start import filter_constants
from mapping.ego_motion.filter_types import Rows, States
from mapping.ego_motion.history import empty_states
from mapping.ego_motion.relative import positive
from mapping.ego_motion.settings import EgoMotionSettings
from mapping.ego_motion.states import (
    COLUMNS,
    FORCE_ERROR,
    PITCH_ERROR,
    ROLL_ERROR,
    SIZE,
    TICK_PITCH_RATE,
    TICK_ROLL,
    TICK_ROLL_RATE,
    TICK_SPEED_WALK,
)
from mapping.errors import MappingError
from mapping.geometry import Float64Array, RigidTransform
from tests.mapping.ego_motion.drives import START_NS, Drive, replay

NO_DELAY = EgoMotionSettings(
    gyro_delay_s=0.0, wheels_delay_s=0.0, acceleration_delay_s=0.0, vibration_delay_s=0.0
)
SMALL = np.diag([1e-6] * 3 + [1e-8] * 3)


def moved(x: Float64Array, held: Float64Array, seconds: float) -> tuple[Float64Array, Float64Array]:
    """Return state and PHI after some time without rows."""
    state = States(
        np.zeros(1, np.int64),
        x[np.newaxis].copy(),
        np.eye(SIZE)[np.newaxis].copy(),
        np.eye(SIZE)[np.newaxis].copy(),
        held[np.newaxis].copy(),
    )
    none = np.zeros(0, np.int64)
    rows = Rows(none, none, np.zeros((0, COLUMNS)), np.zeros((0, 6)), np.zeros((0, 6, 6)))
    constants = filter_constants(EgoMotionSettings())
    run(state, rows, round(seconds * 1e9), constants, empty_states(0), none, np.zeros(0))
    return state.x[0], state.phi[0]


@pytest.mark.parametrize("rest_variance", [1e-4, 0.0], ids=["by the force", "by the wheels"])
def test_the_derivative_of_a_step_is_that_of_its_motion(rest_variance: float) -> None:
    rng = np.random.default_rng(3)
    x = 0.1 * rng.standard_normal(SIZE)
    x[3], x[4], x[5] = 0.7, 0.3, 0.2
    held = np.array([0.05, -0.1, 0.0, 0.0, 1e-4, 1e-4, 0.0, 0.1, 0.1, 0.0, rest_variance, 0.0])
    end, phi = moved(x, held, 0.01)
    for i in range(SIZE):
        ahead = x.copy()
        ahead[i] += 1e-6
        numeric = (moved(ahead, held, 0.01)[0] - end) / 1e-6
        np.testing.assert_allclose(phi[:, i], numeric, atol=2e-5, err_msg=str(i))


def test_a_changing_pitch_turns_a_rolled_rover() -> None:
    held = np.zeros(COLUMNS)
    held[TICK_ROLL], held[TICK_PITCH_RATE], held[TICK_SPEED_WALK] = 0.2, 0.1, 0.1
    end, phi = moved(np.zeros(SIZE), held, 0.01)
    # psi' = p' tan r at p = 0 and no rate about the body's z.
    assert end[3] == pytest.approx(0.1 * np.tan(0.2) * 0.01, rel=1e-4)
    assert phi[3, ROLL_ERROR] == pytest.approx(-0.1 / np.cos(0.2) ** 2 * 0.01, rel=1e-4)
    held[TICK_ROLL_RATE], held[TICK_PITCH_RATE] = 0.1, 0.0
    _, phi = moved(np.zeros(SIZE), held, 0.01)
    # By parts: the rate of the pitch's error becomes the change of tan r times that error.
    assert phi[3, PITCH_ERROR] == pytest.approx(0.1 / np.cos(0.2) ** 2 * 0.01, rel=0.01)
    assert phi[4, FORCE_ERROR] == 0.0


def finished(corrections: str) -> EgoMotion:
    """Return ego-motion after a drive with three corrections: in time, late, or none."""
    drive, ego = Drive(seconds=6.0), EgoMotion(NO_DELAY)
    times = [] if corrections == "none" else [2.51, 3.0, 4.004]
    for sample in drive.samples():
        ego.add(sample)
        ready_s = ((ego.poses_ready_until_ns or 0) - START_NS) * 1e-9
        wait_s = 0.0 if corrections == "in time" else 0.6
        while times and ready_s >= times[0] + wait_s:
            correct(ego, drive, times.pop(0))
    assert not times
    ego.finish()
    return ego


def correct(ego: EgoMotion, drive: Drive, seconds: float) -> bool:
    x, y, yaw = drive.truth(np.array([seconds]))[0]
    cosine, sine = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    pose = RigidTransform(turn, np.array([x, y, 0.0]))
    return ego.correct(START_NS + round(seconds * 1e9), pose, SMALL)


def test_a_late_correction_ends_where_one_in_time_does() -> None:
    t_ns = START_NS + 5_500_000_000
    in_time, late, none = (finished(how).pose_at(t_ns) for how in ("in time", "late", "none"))
    assert in_time is not None
    assert late is not None
    assert none is not None
    np.testing.assert_array_equal(in_time.transform.translation_m, late.transform.translation_m)
    np.testing.assert_array_equal(in_time.covariance, late.covariance)
    assert late.covariance[0, 0] < 0.5 * none.covariance[0, 0]
    true = Drive(seconds=6.0).truth(np.array([5.5]))[0]
    assert abs(late.transform.translation_m[0] - true[0]) < 0.01


def test_an_impossible_correction_is_left_out() -> None:
    ego = finished("none")
    before = ego.pose_at(START_NS + 5_000_000_000)
    away = RigidTransform(np.eye(3), np.array([5.0, 5.0, 5.0]))
    assert not ego.correct(START_NS + 4_000_000_000, away, SMALL)
    after = ego.pose_at(START_NS + 5_000_000_000)
    assert before is not None
    assert after is not None
    np.testing.assert_array_equal(before.covariance, after.covariance)
    assert [event.kind for event in ego.events] == ["pose_rejected"]
    assert not ego.correct(START_NS - 10**12, away, SMALL)
    assert ego.events[-1].kind == "late_sample"


def test_the_joint_covariance_is_that_of_a_clone() -> None:
    """A pose that is measured exactly at t1 tells of t0 what the joint covariance foretells."""
    ego = finished("late")
    t0_ns, t1_ns = START_NS + 4_903_000_000, START_NS + 5_207_000_000
    relative = ego.relative_covariance(t0_ns, t1_ns)
    pose0, pose1 = ego.pose_at(t0_ns), ego.pose_at(t1_ns)
    assert pose0 is not None
    assert pose1 is not None
    np.testing.assert_allclose(relative.joint[:6, :6], pose0.covariance, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(relative.joint[6:, 6:], pose1.covariance, rtol=1e-9, atol=1e-15)
    assert np.linalg.eigvalsh(relative.joint).min() > -1e-12
    assert relative.clipped == 0
    moved_m = pose0.transform.inverse() @ pose1.transform
    np.testing.assert_allclose(relative.transform.translation_m, moved_m.translation_m)
    # 9 cm with wheels that are known to a few percent.
    assert 1e-6 < relative.covariance_xyz_yaw[0, 0] < 1e-4


def test_relative_covariances_of_steps_that_are_put_together_are_too_sure() -> None:
    """Steps share the wheels' scale: adding them as if independent forgets it."""
    ego = EgoMotion(NO_DELAY)
    for _ in replay(ego, Drive(seconds=6.0).samples()):
        pass
    times = [START_NS + round(1e9 * s) for s in np.arange(2.6, 5.41, 0.1)]
    whole = ego.relative_covariance(times[0], times[-1]).covariance[0, 0]
    steps = [ego.relative_covariance(a, b) for a, b in pairwise(times)]
    assert whole > 3.0 * sum(step.covariance[0, 0] for step in steps)


def test_no_motion_between_equal_times() -> None:
    ego = finished("none")
    t_ns = START_NS + 5_003_000_000
    relative = ego.relative_covariance(t_ns, t_ns)
    np.testing.assert_allclose(relative.covariance, 0.0, atol=1e-15)
    with pytest.raises(MappingError, match="expected times in order within"):
        ego.relative_covariance(t_ns, START_NS + 10**12)


def test_negative_eigenvalues_are_clipped_and_counted() -> None:
    fixed, clipped = positive(np.diag([1.0, 2.0, -0.5]))
    assert clipped == 1
    assert np.linalg.eigvalsh(fixed).min() >= 0.0
    assert positive(np.diag([1.0, 0.0]))[1] == 0
    assert positive(np.diag([1.0, -1e-12]))[1] == 0
