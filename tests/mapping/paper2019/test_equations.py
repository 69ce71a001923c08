"""The printed equations against numbers and loops worked out by hand from the paper's page."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapping.paper2019 import equations as paper

variances = st.floats(1e-8, 1.0)
heights = st.floats(-10.0, 10.0)
angles = st.floats(-1.0, 1.0)


def test_eqs_11_to_15_by_hand() -> None:
    """Map 1.00 m +- 20 mm, measurement 1.10 m +- 10 mm: K = 4 / 5."""
    map_m2, measured_m2 = np.array(4e-4), np.array(1e-4)
    assert paper.gain(map_m2, measured_m2) == pytest.approx(0.8, rel=1e-12)
    height = paper.fused_height_m(np.array(1.0), map_m2, np.array(1.1), measured_m2)
    assert height == pytest.approx(1.08, rel=1e-12)
    assert paper.fused_variance_m2(map_m2, measured_m2) == pytest.approx(8e-5, rel=1e-12)


@given(heights, variances, heights, variances)
def test_eq_14_and_eq_13_are_eqs_12_and_15(h: float, p: float, z: float, r: float) -> None:
    a = (np.array(h), np.array(p), np.array(z), np.array(r))
    assert paper.fused_height_m(*a) == pytest.approx((h * r + p * z) / (p + r), abs=1e-9)
    k = p / (p + r)
    assert paper.fused_variance_m2(a[1], a[3]) == pytest.approx((1 - k) * p, rel=1e-6, abs=1e-12)


@given(variances, variances, st.integers(1, 200))
def test_n_updates_one_after_the_other_are_one_with_the_nth_of_the_variance(
    p: float, r: float, n: int
) -> None:
    h, v = 0.3, p
    for _ in range(n):  # eqs. 11, 12, 13, one pixel after the other
        k = v / (v + r)
        h, v = h + k * (0.7 - h), (1 - k) * v
    at_once = np.array(p), np.array(r / n)
    assert paper.fused_variance_m2(*at_once) == pytest.approx(v, rel=1e-8)
    once = paper.fused_height_m(np.array(0.3), at_once[0], np.array(0.7), at_once[1])
    assert once == pytest.approx(h, rel=1e-9)


def test_eqs_16_and_17_by_hand() -> None:
    found = paper.new_covariance_m2(np.array([9e-6]), 0.04)
    np.testing.assert_allclose(found, [np.diag([4e-4, 4e-4, 9e-6])], rtol=1e-12)


def _c_tr(yaw: float, pitch: float, roll: float) -> list[list[float]]:
    """Return C_TR = Rz(yaw) Ry(pitch) Rx(roll), written out."""
    cy, sy, cp, sp, cr, sr = (f(a) for a in (yaw, pitch, roll) for f in (math.cos, math.sin))
    return [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]


def _times(a: list[list[float]], b: list[list[float]]) -> list[list[float]]:
    return [[sum(a[i][k] * b[k][j] for k in range(3)) for j in range(3)] for i in range(3)]


def _transposed(a: list[list[float]]) -> list[list[float]]:
    return [[a[j][i] for j in range(3)] for i in range(3)]


@given(angles, angles, angles, st.tuples(heights, heights, heights), variances, variances)
def test_eqs_28_to_32_by_loops(
    yaw: float, pitch: float, roll: float, r: tuple[float, float, float], step: float, turn: float
) -> None:
    """Every product of the page in plain Python, with a full S_r and S_Phi = diag(0, 0, turn)."""
    c = _c_tr(yaw, pitch, roll)
    before = [[2e-3, 1e-4, 3e-5], [1e-4, 1e-3, 2e-5], [3e-5, 2e-5, 4e-4]]
    s_r = [[step, 0.1 * step, 0.0], [0.1 * step, 2.0 * step, 0.0], [0.0, 0.0, 0.5 * step]]
    s_phi = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, turn]]
    cross = [[0.0, -r[2], r[1]], [r[2], 0.0, -r[0]], [-r[1], r[0], 0.0]]
    j_r = [[-value for value in row] for row in c]
    j_phi = [[-value for value in row] for row in _times(c, cross)]
    by_translation = _times(_times(j_r, s_r), _transposed(j_r))
    by_rotation = _times(_times(j_phi, s_phi), _transposed(j_phi))
    expected = np.array(before) + by_translation + by_rotation
    c_tr = np.array(c)
    found = paper.moved_covariance_m2(np.array([before]), c_tr, np.array([r]), np.array(s_r), turn)
    np.testing.assert_allclose(found[0], expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(paper.translation_jacobian(c_tr), j_r)
    np.testing.assert_allclose(paper.rotation_jacobian(c_tr, np.array(r)), j_phi, atol=1e-12)


def test_the_printed_jacobian_leaks_yaw_into_height() -> None:
    """3 degrees of yaw, 20 degrees of pitch, a point 2.2 m to the left: sin(20 deg) 2.2 m 0.052."""
    c_tr = np.array(_c_tr(0.0, math.radians(20.0), 0.0))
    moved = paper.moved_covariance_m2(
        np.zeros((1, 3, 3)),
        c_tr,
        np.array([[0.0, 2.2, 0.0]]),
        np.zeros((3, 3)),
        math.radians(3.0) ** 2,
    )
    assert math.sqrt(moved[0, 2, 2]) == pytest.approx(0.0394, abs=1e-4)
    # Upright, the frames agree and nothing leaks.
    level = paper.moved_covariance_m2(
        np.zeros((1, 3, 3)), np.eye(3), np.array([[0.0, 2.2, 0.0]]), np.zeros((3, 3)), 0.01
    )
    assert level[0, 2, 2] == 0.0
