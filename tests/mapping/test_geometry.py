"""Rigid transforms, and the pose between two poses."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mapping.errors import MappingError
from mapping.geometry import RigidTransform, UncertainPose, interpolate_pose, skew

Float64Array = NDArray[np.float64]


def vectors(largest: float = 10.0) -> st.SearchStrategy[Float64Array]:
    number = st.floats(-largest, largest)
    return st.tuples(number, number, number).map(np.array)


transforms = st.builds(
    lambda position, turn: RigidTransform(Rotation.from_rotvec(turn).as_matrix(), position),
    vectors(),
    vectors(3.0),
)


@given(transforms, transforms, vectors())
def test_a_product_maps_like_one_after_the_other(
    first: RigidTransform, second: RigidTransform, point: Float64Array
) -> None:
    expected = first.apply(second.apply(point))
    np.testing.assert_allclose((first @ second).apply(point), expected, atol=1e-11)


@given(transforms, vectors())
def test_the_inverse_leads_back(transform: RigidTransform, point: Float64Array) -> None:
    there = transform.apply(point)
    np.testing.assert_allclose(transform.inverse().apply(there), point, atol=1e-11)
    both = transform @ transform.inverse()
    np.testing.assert_allclose(both.rotation, np.eye(3), atol=1e-12)


def test_the_identity_changes_nothing_to_the_bit() -> None:
    point = np.array([0.1, -2.0, 3.3])
    assert RigidTransform.identity().apply(point).tobytes() == point.tobytes()


def test_points_of_any_shape_are_mapped() -> None:
    quarter = RigidTransform.from_quat_wxyz(
        np.array([1.0, 2.0, 3.0]), np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
    )
    points = np.zeros((4, 5, 3))
    points[..., 0] = 1.0  # x becomes y under a quarter turn about z
    expected = np.broadcast_to([1.0, 3.0, 3.0], (4, 5, 3))
    np.testing.assert_allclose(quarter.apply(points), expected, atol=1e-12)


@given(vectors(), vectors())
def test_skew_is_the_cross_product(v: Float64Array, w: Float64Array) -> None:
    np.testing.assert_allclose(skew(v) @ w, np.cross(v, w), atol=1e-12)


@pytest.mark.parametrize(
    ("position", "quat", "reason"),
    [
        ((0, 0, np.nan), (1, 0, 0, 0), r"position is \(0, 0, nan\) m; expected numbers up to"),
        ((np.inf, 0, 0), (1, 0, 0, 0), r"position is \(inf, 0, 0\) m"),
        ((0, -2e8, 0), (1, 0, 0, 0), r"position is \(0, -2e\+08, 0\) m"),
        ((0, 0, 0), (0, 0, 0, 0), r"quaternion wxyz \(0, 0, 0, 0\) has length 0; expected 1"),
        ((0, 0, 0), (1, 0, 0.1, 0), r"has length 1\.005; expected 1"),
        ((0, 0, 0), (np.nan, 0, 0, 0), "has length nan; expected 1"),
        ((0, 0, 0), (1e300, 1e300, 0, 0), r"has length 1\.414e\+300; expected 1"),
    ],
)
def test_what_is_no_pose_is_refused(
    position: tuple[float, ...], quat: tuple[float, ...], reason: str
) -> None:
    with pytest.raises(MappingError, match=reason):
        RigidTransform.from_quat_wxyz(np.array(position, float), np.array(quat, float))


def _pose(t_ns: int, transform: RigidTransform, variance: float = 0.0) -> UncertainPose:
    return UncertainPose(t_ns, transform, variance * np.eye(6))


def test_between_two_poses_motion_and_turn_are_uniform() -> None:
    turn = Rotation.from_rotvec([0.3, -0.2, 0.5])
    start = Rotation.from_rotvec([0.1, 0.2, 0.3])
    before = _pose(1000, RigidTransform(start.as_matrix(), np.array([1.0, 2.0, 3.0])), 0.1)
    end = (start * turn).as_matrix()
    after = _pose(5000, RigidTransform(end, np.array([2.0, 0.0, 3.5])), 0.3)
    found = interpolate_pose(before, after, 2000)
    assert found.t_ns == 2000
    np.testing.assert_allclose(found.transform.translation_m, [1.25, 1.5, 3.125])
    quarter = start * Rotation.from_rotvec(0.25 * turn.as_rotvec())
    np.testing.assert_allclose(found.transform.rotation, quarter.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(found.covariance, 0.15 * np.eye(6))


@given(transforms, transforms)
def test_the_ends_come_back_bit_for_bit(first: RigidTransform, second: RigidTransform) -> None:
    before, after = _pose(10, first), _pose(30, second)
    assert interpolate_pose(before, after, 10) is before
    assert interpolate_pose(before, after, 30) is after


def test_stamps_of_today_lose_no_nanosecond() -> None:
    first_ns = 1_767_225_600_000_000_000
    before = _pose(first_ns, RigidTransform(np.eye(3), np.zeros(3)))
    after = _pose(first_ns + 4, RigidTransform(np.eye(3), np.full(3, 4.0)))
    found = interpolate_pose(before, after, first_ns + 1)
    np.testing.assert_array_equal(found.transform.translation_m, np.ones(3))
