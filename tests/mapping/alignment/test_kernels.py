"""The loops of the alignment against plain numpy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mapping.alignment.plane_kernels import (
    PLANE_COLUMNS,
    PLANE_HEIGHT,
    PLANE_SLOPE_X,
    PLANE_SLOPE_Y,
    PLANE_VARIANCE,
    WindowPlace,
    fit_planes,
)
from mapping.alignment.residual_kernels import Guess, Weighting, normal_equations

Float64Array = NDArray[np.float64]
CELL_M = 0.05


@settings(max_examples=30)
@given(seed=st.integers(0, 10_000), holes=st.integers(0, 5))
def test_planes_are_least_squares(seed: int, holes: int) -> None:
    random = np.random.default_rng(seed)
    heights = random.normal(0.0, 0.1, (3, 3))
    frames = np.ones((3, 3), np.uint32)
    empty = random.choice([0, 1, 2, 3, 5, 6, 7, 8], holes, replace=False)
    frames.flat[empty] = 0
    planes = np.zeros((9, PLANE_COLUMNS))
    place = WindowPlace(0, 0, 3, 3, CELL_M)
    fit_planes(heights, frames, 5 * frames, place, 5, planes)
    plane = planes[4]
    rows, columns = np.nonzero(frames)
    design = np.stack([np.ones(len(rows)), CELL_M * (columns - 1), CELL_M * (rows - 1)], axis=1)
    if len(rows) < 6 or np.linalg.matrix_rank(design) < 3:
        assert plane[PLANE_VARIANCE] < 0.0
        return
    (_, slope_x, slope_y), squares, *_ = np.linalg.lstsq(design, heights[rows, columns], rcond=None)
    assert plane[PLANE_HEIGHT] == heights[1, 1]
    assert plane[PLANE_SLOPE_X] == pytest.approx(slope_x, abs=1e-9)
    assert plane[PLANE_SLOPE_Y] == pytest.approx(slope_y, abs=1e-9)
    assert plane[PLANE_VARIANCE] == pytest.approx(squares[0] / (len(rows) - 3), abs=1e-12)


def test_cells_with_too_few_readings_make_no_plane() -> None:
    planes = np.zeros((9, PLANE_COLUMNS))
    ones = np.ones((3, 3), np.uint32)
    fit_planes(np.zeros((3, 3)), ones, ones, WindowPlace(0, 0, 3, 3, CELL_M), 2, planes)
    assert (planes[:, PLANE_VARIANCE] < 0.0).all()


def _cost_and_gradient(delta: Float64Array) -> tuple[float, Float64Array, Float64Array]:
    """Return sum w r^2 / 2, its gradient by (shift, rotation), and J' w J, at a pose.

    Nine points over one plane that fills the window, at which no weight depends on the pose.
    """
    u, v = np.meshgrid([0.5, 1.5, 2.5], [0.5, 1.5, 2.5])
    points = np.stack([u.ravel(), v.ravel(), 0.1 * np.sin(7.0 * u.ravel() + v.ravel())], axis=1)
    points = np.concatenate([points, np.full((9, 2), 2.0)], axis=1)
    planes = np.tile([0.05, 0.2, -0.1, 1e-4, 0.0], (1, 1))
    turn = Rotation.from_rotvec(delta[3:]).as_matrix()
    place = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0)  # camera 1 m above the body, window's corner under it
    guess = Guess._make([*turn.ravel(), *delta[:3], *place, 4.0, 1, 1])
    sums, residuals = np.zeros((13, 6)), np.zeros(9)
    weighting = Weighting(1.0, np.inf, 1e-4)
    met = normal_equations(points, np.zeros(9), planes, guess, weighting, sums, residuals)
    assert met == 9
    normal = np.tril(sums[:6]) + np.tril(sums[:6], -1).T
    return 0.5 * float((residuals**2).sum()), sums[12].copy(), normal


def test_the_gradient_is_that_of_the_cost() -> None:
    cost, gradient, normal = _cost_and_gradient(np.zeros(6))
    step = 1e-6
    for axis in range(6):
        ahead = _cost_and_gradient(step * np.eye(6)[axis])
        behind = _cost_and_gradient(-step * np.eye(6)[axis])
        # The weight's nz belongs to the plane, not to the pose: the cost is quadratic.
        assert (ahead[0] - behind[0]) / (2.0 * step) == pytest.approx(gradient[axis], rel=1e-5)
        if axis < 3:
            curvature = (ahead[0] - 2.0 * cost + behind[0]) / step**2
            assert curvature == pytest.approx(normal[axis, axis], rel=0.02)


def test_a_residual_of_the_scale_weighs_half() -> None:
    points = np.array([[0.5, 0.5, 0.02, 2.0, 9.0]])
    planes = np.array([[0.0, 0.0, 0.0, 3e-4, 0.0]])
    place = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    guess = Guess._make([*np.eye(3).ravel(), *np.zeros(3), *place, 1, 1])
    sums, residuals = np.zeros((13, 6)), np.zeros(1)
    arguments = points, np.zeros(1), planes, guess
    normal_equations(*arguments, Weighting(1.0, np.inf, 1e-4), sums, residuals)
    assert residuals[0] == pytest.approx(1.0)
    assert sums[2, 2] == pytest.approx(2500.0)
    normal_equations(*arguments, Weighting(1.0, 1.0, 1e-4), sums, residuals)
    assert sums[2, 2] == pytest.approx(1250.0)
    assert normal_equations(*arguments, Weighting(0.019, 1.0, 1e-4), sums, residuals) == 0
