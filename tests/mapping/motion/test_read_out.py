"""What poses and motions add when a map is read out, cell by cell against the equations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.samples import DepthFrame
from mapping.cells.cell_layers import empty_layers
from mapping.cells.elevation_map import CellState
from mapping.mapper import Mapper
from mapping.motion.ledger import MotionLedger, at_rest
from mapping.motion.pose_errors import ABSOLUTE, ALIGNED, RELATIVE, PoseErrorModel
from mapping.motion.read_out import Rover, place_errors, standing
from mapping.motion.relative import RelativeMotion
from mapping.noise import constant_noise
from mapping.settings import MapSettings
from tests.mapping.motion.sweep import growth
from tests.mapping.scenes import CAMERA, looking, millimetres, mount, plane_z, pose_sample

Float64Array = NDArray[np.float64]

X_M = np.array([-0.5, 0.3, 2.0])
Y_M = np.array([1.0, -1.5])

roots = st.tuples(*[st.floats(-0.05, 0.05)] * 16).map(lambda v: np.reshape(v, (4, 4)))
motions = st.builds(
    lambda root, x, y, yaw, way: RelativeMotion(0, np.array([x, y, 0.2]), yaw, root @ root.T, way),
    roots,
    st.floats(-50.0, 50.0),
    st.floats(-50.0, 50.0),
    st.floats(-math.pi, math.pi),
    st.floats(0.0, 0.5),
)


@given(st.lists(motions, max_size=6), st.integers(0, 6))
def test_what_cells_have_missed_is_what_a_sweep_would_have_told_them(
    taken: list[RelativeMotion], seen_after: int
) -> None:
    ledger = MotionLedger(with_covariance=True)
    layers = empty_layers(2, 3)
    expected = np.zeros((2, 3, 3, 3))
    for number, motion in enumerate(taken, 1):
        ledger.add(motion)
        if number <= seen_after:
            layers.motion[:] = ledger.motions.now
            continue
        for (row, column), _ in np.ndenumerate(layers.motion):
            cell = np.array([X_M[column], Y_M[row], 0.0])
            expected[row, column] += growth(motion, cell)
    found = place_errors(layers, X_M, Y_M, Rover(0.0, 0.0, ledger.motions, RELATIVE))
    scale = 1e-9 * (1.0 + expected.max())
    np.testing.assert_allclose(found.xx_m2, expected[..., 0, 0], rtol=1e-6, atol=scale)
    np.testing.assert_allclose(found.xy_m2, expected[..., 0, 1], rtol=1e-6, atol=scale)
    np.testing.assert_allclose(found.yy_m2, expected[..., 1, 1], rtol=1e-6, atol=scale)
    np.testing.assert_allclose(found.height_m2, expected[..., 2, 2], atol=1e-12)
    assert (found.xx_m2 * found.yy_m2 - found.xy_m2**2 >= -1e-12).all()
    assert not found.pose_m2.any()


@given(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), st.floats(0.0, 30.0))
def test_the_parts_of_an_aligned_source(rover_x: float, rover_y: float, driven_m: float) -> None:
    layers = empty_layers(2, 3)
    layers.stale_m[:] = driven_m
    found = place_errors(layers, X_M, Y_M, Rover(rover_x, rover_y, at_rest(), ALIGNED))
    for (row, column), pose_m2 in np.ndenumerate(found.pose_m2):
        r = np.array([X_M[column] - rover_x, Y_M[row] - rover_y, 0.0])
        range_m = float(np.linalg.norm(r))
        frame = 0.001**2 + (math.radians(0.03) * range_m) ** 2
        gravity = (math.radians(0.12) * range_m) ** 2
        drifted = 1.0 + float(layers.stale_m[row, column])
        assert pose_m2 == pytest.approx(frame * drifted + gravity, rel=1e-9)
        turned = np.cross([0.0, 0.0, 1.0], r)[:2]
        place = 0.003**2 * np.eye(2) + math.radians(0.05) ** 2 * np.outer(turned, turned)
        cell = row, column
        covariance = [
            [found.xx_m2[cell], found.xy_m2[cell]],
            [found.xy_m2[cell], found.yy_m2[cell]],
        ]
        np.testing.assert_allclose(covariance, place * drifted, rtol=1e-6, atol=1e-12)


def _slope_mapper(pose_errors: PoseErrorModel = ABSOLUTE, covariance: float = 0.0) -> Mapper:
    """Return a mapper that saw a slope of 0.3 along x and -0.1 along y."""
    mapper = Mapper(MapSettings(), constant_noise(0.001), pose_errors=pose_errors)
    mapper.add(mount())
    for n in range(3):
        rotation, position = looking(10.0 * n, 40.0), np.array([0.0, 0.0, 1.0])
        z_m = plane_z(CAMERA, rotation, (-0.3, 0.1, 1.0), -1.0)
        pose = pose_sample(n * 10**9, position, rotation, covariance * np.eye(6))
        mapper.add(pose)
        mapper.add(DepthFrame(pose.t_ns, millimetres(z_m), CAMERA, n))
    mapper.finish()
    return mapper


def test_an_absolute_source_adds_nothing_to_a_map() -> None:
    map_ = _slope_mapper().elevation_map()
    known = map_.known
    assert not map_.pose_m2[known].any()
    assert not map_.horizontal_m2[known].any()
    np.testing.assert_allclose(map_.horizontal_xx_m2[known], 0.02**2, rtol=1e-6)
    np.testing.assert_allclose(map_.horizontal_yy_m2[known], 0.02**2, rtol=1e-6)
    assert not map_.horizontal_xy_m2[known].any()


def test_motion_makes_sloping_ground_less_certain_also_without_depth() -> None:
    mapper = _slope_mapper(RELATIVE)
    before = mapper.elevation_map()
    sideways = np.diag([4e-4, 1e-4, 0.0, 1e-4])
    mapper.move(RelativeMotion(3 * 10**9, np.array([0.2, 0.0, 1.0]), 0.0, sideways, 0.2))
    after = mapper.elevation_map()
    inner = (after.state == CellState.MEASURED) & (after.frames == 3)
    np.testing.assert_array_equal(after.elevation_m, before.elevation_m)
    row, column = map(int, np.argwhere(inner)[len(np.argwhere(inner)) // 2])
    cell = np.array([after.x_m[column], after.y_m[row], 0.0])
    motion = RelativeMotion(0, np.array([0.2, 0.0, 1.0]), 0.0, sideways, 0.2)
    grown = growth(motion, cell)[:2, :2]
    slope = np.array([0.3, -0.1])
    expected = float(slope @ grown @ slope)
    assert after.horizontal_m2[row, column] == pytest.approx(expected, rel=0.25)
    assert after.horizontal_xx_m2[row, column] == pytest.approx(0.02**2 + grown[0, 0], rel=1e-5)
    total = sum(
        getattr(after, f"{name}_m2")[row, column]
        for name in ("independent", "systematic", "relief", "pose", "horizontal")
    )
    assert after.variance_m2[row, column] == pytest.approx(total, rel=1e-6)
    assert mapper.counts.motions == 1


def test_the_covariance_of_a_pose_is_left_out_where_the_model_stands_for_it() -> None:
    counted = _slope_mapper(ABSOLUTE, 1e-4).elevation_map()
    left_out = _slope_mapper(PoseErrorModel(pose_covariance=False), 1e-4).elevation_map()
    none = _slope_mapper(ABSOLUTE, 0.0).elevation_map()
    np.testing.assert_array_equal(left_out.independent_m2, none.independent_m2)
    aligned = [_slope_mapper(ALIGNED, m2).elevation_map().independent_m2 for m2 in (1e-4, 1e-2)]
    np.testing.assert_array_equal(aligned[0], aligned[1])
    assert np.nanmedian(counted.independent_m2) > 10.0 * np.nanmedian(none.independent_m2)
    assert np.nanmin(_slope_mapper(ALIGNED).elevation_map().pose_m2) > 0.0


def test_a_motion_that_learned_is_counted() -> None:
    mapper = _slope_mapper(RELATIVE)
    mapper.move(RelativeMotion(4, np.zeros(3), 0.0, np.diag([1.0, -1.0, 0.0, 0.0]), 0.0))
    assert (mapper.counts.motions, mapper.counts.motions_clipped) == (1, 1)


def test_a_rover_that_stands_adds_nothing() -> None:
    found = place_errors(empty_layers(2, 3), X_M, Y_M, standing(1.0, 2.0))
    assert not any(layer.any() for layer in found)
