"""The sums of motions: against a sweep that takes every motion to every cell."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from mapping.errors import MappingError
from mapping.motion.ledger import SUM_M, SUM_ZZ, MotionLedger
from mapping.motion.relative import RelativeMotion
from tests.mapping.motion.sweep import growth

Float64Array = NDArray[np.float64]

roots = st.tuples(*[st.floats(-0.1, 0.1)] * 16).map(lambda v: np.reshape(v, (4, 4)))
places = st.tuples(*[st.floats(-20.0, 20.0)] * 3).map(np.array)
motions = st.builds(
    lambda root, place, yaw, way: RelativeMotion(0, place, yaw, root @ root.T, way),
    roots,
    places,
    st.floats(-math.pi, math.pi),
    st.floats(0.0, 1.0),
)


def _gained(sums: Float64Array, x: float, y: float) -> Float64Array:
    """Return J S J' for a cell at (x, y) from the anchor."""
    planar = sums[[[0, 1, 3], [1, 2, 4], [3, 4, 5]]]
    jacobian = np.array([[1.0, 0.0, -y], [0.0, 1.0, x]])
    gained: Float64Array = jacobian @ planar @ jacobian.T
    return gained


@given(st.lists(motions, min_size=1, max_size=6), places)
def test_the_sums_give_what_a_sweep_over_the_cells_gives(
    taken: list[RelativeMotion], cell: Float64Array
) -> None:
    ledger = MotionLedger(with_covariance=True)
    for motion in taken:
        ledger.add(motion)
    sums, now, anchor_x, anchor_y = ledger.motions
    expected = sum((growth(motion, cell) for motion in taken), np.zeros((3, 3)))
    found = _gained(sums[now], cell[0] - anchor_x, cell[1] - anchor_y)
    np.testing.assert_allclose(found, expected[:2, :2], atol=1e-8 * (1.0 + expected.max()))
    assert sums[now, SUM_ZZ] == pytest.approx(expected[2, 2], abs=1e-12)
    assert sums[now, SUM_M] == pytest.approx(sum(m.distance_m for m in taken))


def test_a_rover_at_rest_needs_no_rows_and_many_motions_get_theirs() -> None:
    ledger = MotionLedger(with_covariance=True)
    for _ in range(5):
        ledger.add(RelativeMotion(0, np.ones(3), 0.0, np.zeros((4, 4)), 0.0))
    assert ledger.motions.now == 0
    for n in range(3000):
        ledger.add(RelativeMotion(n, np.zeros(3), 0.0, np.eye(4), 0.5))
    assert ledger.motions.now == 3000
    assert ledger.motions.sums[1500, SUM_M] == 750.0
    assert not ledger.motions.sums[0].any()


def test_without_covariance_only_the_way_counts() -> None:
    ledger = MotionLedger(with_covariance=False)
    ledger.add(RelativeMotion(0, np.ones(3), 0.0, np.eye(4), 0.25))
    assert ledger.motions.sums[1].tolist() == [0.0] * 7 + [0.25]


def test_a_negative_direction_is_clipped_and_counted() -> None:
    ledger = MotionLedger(with_covariance=True)
    ledger.add(RelativeMotion(0, np.zeros(3), 0.3, np.diag([1.0, -1.0, 1.0, 1.0]), 0.1))
    ledger.add(RelativeMotion(0, np.zeros(3), 0.3, np.eye(4), 0.1))
    assert ledger.clipped == 1


@pytest.mark.parametrize(
    "motion",
    [
        RelativeMotion(7, np.array([0.0, math.nan, 0.0]), 0.0, np.eye(4), 0.1),
        RelativeMotion(7, np.zeros(3), math.inf, np.eye(4), 0.1),
        RelativeMotion(7, np.zeros(3), 0.0, np.full((4, 4), math.nan), 0.1),
        RelativeMotion(7, np.zeros(3), 0.0, np.eye(4), -0.1),
    ],
)
def test_a_motion_that_is_none_is_refused_and_changes_nothing(motion: RelativeMotion) -> None:
    ledger = MotionLedger(with_covariance=True)
    with pytest.raises(MappingError, match="motion that ends at 7 ns"):
        ledger.add(motion)
    assert ledger.motions.now == 0
