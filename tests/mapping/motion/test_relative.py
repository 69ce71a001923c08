"""The uncertainty of a motion between two poses, against the motion itself."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mapping.errors import MappingError
from mapping.geometry import RigidTransform, UncertainPose
from mapping.motion.pose_errors import ABSOLUTE, ALIGNED, RELATIVE, PoseErrorModel
from mapping.motion.relative import (
    RelativeMotion,
    clip_to_psd,
    relative_covariance,
    upright_covariance,
    yaw_of,
)
from tests.mapping.motion.sweep import growth

Float64Array = NDArray[np.float64]

numbers = st.floats(-1.0, 1.0)
yaws = st.floats(-math.pi, math.pi)
roots = st.tuples(*[numbers] * 16).map(lambda values: np.reshape(values, (4, 4)))
motions = st.tuples(*[numbers] * 3).map(np.array)


def _turn(yaw_rad: float) -> Float64Array:
    turn: Float64Array = Rotation.from_euler("z", yaw_rad).as_matrix()
    return turn


def _moved(state: Float64Array, motion: Float64Array) -> Float64Array:
    """Return the pose (x, y, z, yaw) after a motion given in the upright body's axes."""
    place = state[:3] + _turn(state[3]) @ motion[:3]
    return np.append(place, state[3] + motion[3])


def _derivative(of: int, state: Float64Array, motion: Float64Array) -> Float64Array:
    """Return d moved / d state (of = 0) or d motion (of = 1) by central differences."""
    columns = []
    for axis in range(4):
        step = 1e-6 * np.eye(4)[axis]
        ends = [(state + sign * step, motion) for sign in (1, -1)]
        if of == 1:
            ends = [(state, motion + sign * step) for sign in (1, -1)]
        columns.append((_moved(*ends[0]) - _moved(*ends[1])) / 2e-6)
    return np.stack(columns, axis=1)


@given(roots, roots, motions, numbers, yaws)
def test_the_covariance_that_a_motion_added_is_found_again(
    before_root: Float64Array,
    added_root: Float64Array,
    motion: Float64Array,
    turned: float,
    yaw: float,
) -> None:
    state, step = np.append([0.3, -0.2, 0.1], yaw), np.append(motion, turned)
    before, added = before_root @ before_root.T, added_root @ added_root.T
    forward, gain = _derivative(0, state, step), _derivative(1, state, step)
    after = forward @ before @ forward.T + gain @ added @ gain.T
    found = relative_covariance(before, after, _turn(yaw) @ motion, yaw)
    np.testing.assert_allclose(found.covariance, added, atol=1e-7)


@given(roots, roots, motions, yaws)
def test_it_is_never_negative_in_any_direction(
    before_root: Float64Array, after_root: Float64Array, motion: Float64Array, yaw: float
) -> None:
    before, after = before_root @ before_root.T, after_root @ after_root.T
    found = relative_covariance(before, after, motion, yaw)
    assert np.linalg.eigvalsh(found.covariance)[0] >= -1e-12


def test_a_filter_that_learned_is_clipped_and_one_that_did_not_is_not() -> None:
    before = np.diag([4.0, 1.0, 1.0, 1.0])
    learned = relative_covariance(before, np.diag([1.0, 2.0, 1.0, 1.0]), np.zeros(3), 0.0)
    assert learned.was_clipped
    np.testing.assert_allclose(learned.covariance, np.diag([0.0, 1.0, 0.0, 0.0]), atol=1e-12)
    assert not relative_covariance(before, before, np.zeros(3), 0.7).was_clipped


@given(roots)
def test_clipping_adds_and_never_takes_away(root: Float64Array) -> None:
    matrix = 0.5 * (root + root.T)
    clipped, was_clipped = clip_to_psd(matrix)
    assert np.linalg.eigvalsh(clipped - matrix)[0] >= -1e-9
    assert np.linalg.eigvalsh(clipped)[0] >= -1e-9
    if np.linalg.eigvalsh(matrix)[0] < -1e-9:
        assert was_clipped


@given(yaws, st.floats(-1.2, 1.2), st.floats(-1.2, 1.2), st.tuples(*[numbers] * 36))
def test_yaw_of_a_tilted_pose_against_turning_it(
    yaw: float, pitch: float, roll: float, values: tuple[float, ...]
) -> None:
    rotation = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()

    def turned_yaw(axis: int, angle: float) -> float:
        turn = Rotation.from_rotvec(angle * np.eye(3)[axis]).as_matrix()
        turned = yaw_of(RigidTransform(turn @ rotation, np.zeros(3)))
        return math.remainder(turned - yaw, 2.0 * math.pi)

    slopes = [(turned_yaw(axis, 1e-6) - turned_yaw(axis, -1e-6)) / 2e-6 for axis in range(3)]
    jacobian = np.zeros((4, 6))
    jacobian[:3, :3], jacobian[3, 3:] = np.eye(3), slopes
    root = np.reshape(values, (6, 6))
    pose = UncertainPose(0, RigidTransform(rotation, np.zeros(3)), root @ root.T)
    expected = jacobian @ pose.covariance @ jacobian.T
    np.testing.assert_allclose(upright_covariance(pose), expected, rtol=1e-5, atol=1e-5)


def test_the_presets_count_nothing_twice() -> None:
    assert PoseErrorModel() == ABSOLUTE
    assert not ABSOLUTE.motion_covariance
    assert RELATIVE.motion_covariance
    assert not ALIGNED.pose_covariance
    assert ALIGNED.gravity_sigma_rad == pytest.approx(0.12 * math.pi / 180.0)


@pytest.mark.parametrize(
    ("given_", "message"),
    [
        ({"frame_sigma_m": 0.001}, "pose_covariance and frame_sigma_m or frame_sigma_rad"),
        ({"motion_covariance": True, "place_sigma_m": 0.003}, "would count one error twice"),
        ({"drift_per_m": -1.0}, "drift_per_m is -1.0; expected 0 or more"),
        ({"gravity_sigma_rad": math.nan}, "gravity_sigma_rad is nan"),
    ],
)
def test_what_would_count_an_error_twice_is_refused(given_: dict[str, float], message: str) -> None:
    with pytest.raises(MappingError, match=message):
        PoseErrorModel(**given_)  # type: ignore[arg-type] # a mixture of flags and numbers


@given(roots, motions, numbers, yaws, st.tuples(*[st.floats(-5.0, 5.0)] * 3).map(np.array))
def test_a_wrong_motion_moves_a_cell_as_seen_from_the_rover(
    root: Float64Array, motion: Float64Array, turned: float, yaw: float, cell: Float64Array
) -> None:
    """dr + (e x r) d_yaw, r from the rover after the motion, dr in its axes before it."""
    start, step = np.append([0.3, -0.2, 0.1], yaw), np.append(motion, turned)
    end = _moved(start, step)

    def seen(error: Float64Array) -> Float64Array:
        wrong = _moved(start, step + error)
        place: Float64Array = _turn(end[3]) @ _turn(wrong[3]).T @ (cell - wrong[:3])
        return place

    columns = [(seen(d) - seen(-d)) / 2e-6 for d in 1e-6 * np.eye(4)]
    jacobian = np.stack(columns, axis=1)
    taken = RelativeMotion(0, end[:3], yaw, root @ root.T, 0.0)
    expected = jacobian @ taken.covariance @ jacobian.T
    np.testing.assert_allclose(growth(taken, cell), expected, atol=1e-6)
