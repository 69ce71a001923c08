"""Every sensitivity that the map uses, against finite differences of the geometry itself."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mapping.cells.cell_layers import CellLayers, empty_layers
from mapping.cells.grid import CellWindow
from mapping.cells.update_constants import fusion_constants
from mapping.cells.update_kernels import fuse
from mapping.geometry import RigidTransform
from mapping.measurement import FrameReducer, View
from mapping.motion.ledger import at_rest
from mapping.noise import DepthNoiseModel
from mapping.settings import MapSettings
from tests.mapping.cells import sums_of
from tests.mapping.scenes import CAMERA, view_of

Float64Array = NDArray[np.float64]

STEP = 1e-5
OWN_M2 = 1e-8
MOUNT_RAD = 0.01
NOISE = DepthNoiseModel(
    "biased", axial_offset_m=0.01, bias_sigma_m=0.003, bias_sigma_quadratic_per_m=0.002
)

rotations = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(
    lambda turn: Rotation.from_rotvec(turn).as_matrix()
)
positions = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)
# A point in the optical frame, as a reading could be.
points = st.builds(
    lambda x, y, z: np.array([x * z, y * z, z]),
    st.floats(-0.5, 0.5),
    st.floats(-0.4, 0.4),
    st.floats(0.5, 4.0),
)
# (6, 6) of (x, y, z, rotation about x, y, z): any, with all correlations.
covariances = st.tuples(*[st.floats(-0.01, 0.01)] * 36).map(
    lambda numbers: np.reshape(numbers, (6, 6)) @ np.reshape(numbers, (6, 6)).T
)


def _layers_after(view: View, point_s: Float64Array) -> tuple[CellLayers, Float64Array]:
    """Return a one-cell map that saw that point of the sensor frame, and its place in T.

    The cell is tiny, so that its middle is the point.
    """
    settings = MapSettings(
        resolution_m=1e-5, mount_sigma_rad=MOUNT_RAD, sigma_floor_m=1e-5, sigma_ceiling_m=1e3
    )
    point = view.T_terrain_sensor.apply(point_s)
    cell = np.floor(point[:2] / 1e-5).astype(int)
    window = CellWindow(int(cell[0]), int(cell[1]), 1, 1)
    reducer = FrameReducer(CAMERA, NOISE, settings)
    layers = empty_layers(1, 1)
    height = float(point[2] - view.T_terrain_sensor.translation_m[2])
    frame = reducer.frame_constants(view, window, (0, 0))
    fuse(sums_of([height], 1.0 / OWN_M2), frame, fusion_constants(settings), layers, at_rest())
    return layers, point


def _slope(height_m: Callable[[float], float]) -> float:
    """Return the derivative at 0 by central differences."""
    return (height_m(STEP) - height_m(-STEP)) / (2.0 * STEP)


def _turned(axis: int, angle_rad: float) -> Float64Array:
    turn: Float64Array = Rotation.from_rotvec(angle_rad * np.eye(3)[axis]).as_matrix()
    return turn


def _pose_jacobian(view: View, point: Float64Array) -> Float64Array:
    """Return dh of the body's position in T and rotation about T's axes: (6,)."""
    body = view.body.transform.translation_m

    def height(axis: int, amount: float) -> float:
        if axis < 3:
            return float((point + amount * np.eye(3)[axis])[2])
        return float((body + _turned(axis - 3, amount) @ (point - body))[2])

    return np.array([_slope(partial(height, axis)) for axis in range(6)])


@given(rotations, positions, positions, points, covariances)
def test_the_pose_moves_heights_as_the_turned_rover_does(
    rotation: Float64Array,
    position_m: Float64Array,
    lever_m: Float64Array,
    point_s: Float64Array,
    covariance: Float64Array,
) -> None:
    view = view_of(rotation, position_m, lever_m, covariance)
    layers, point = _layers_after(view, point_s)
    jacobian = _pose_jacobian(view, point)
    expected = float(jacobian @ covariance @ jacobian) + OWN_M2
    # The middle of the cell is up to 7 um from the point.
    assert layers.variance_m2[0, 0] == pytest.approx(expected, rel=1e-4, abs=1e-9)


@given(rotations, positions, positions, points, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_neither_yaw_nor_a_shift_sideways_moves_a_height(
    rotation: Float64Array,
    position_m: Float64Array,
    lever_m: Float64Array,
    point_s: Float64Array,
    shift_m2: float,
    yaw_rad2: float,
) -> None:
    covariance = np.diag([shift_m2, shift_m2, 0.0, 0.0, 0.0, yaw_rad2])
    covariance[0, 5] = covariance[5, 0] = 0.5 * min(shift_m2, yaw_rad2)
    layers, _ = _layers_after(view_of(rotation, position_m, lever_m, covariance), point_s)
    assert layers.variance_m2[0, 0] == pytest.approx(OWN_M2, rel=1e-6)


@given(rotations, positions, points)
def test_the_mount_moves_heights_as_the_turned_sensor_does(
    rotation: Float64Array, position_m: Float64Array, point_s: Float64Array
) -> None:
    view = view_of(rotation, position_m)
    layers, _ = _layers_after(view, point_s)
    found = [
        layers.systematic_a_m[0, 0],
        layers.systematic_b_m[0, 0],
        layers.systematic_c_m[0, 0],
    ]
    camera = view.T_terrain_sensor

    def height(axis: int, angle_rad: float) -> float:
        crooked = RigidTransform(camera.rotation @ _turned(axis, angle_rad), camera.translation_m)
        return float(crooked.apply(point_s)[2])

    for axis, sensitivity in enumerate(found):
        expected = MOUNT_RAD * _slope(partial(height, axis))
        assert sensitivity == pytest.approx(expected, abs=1e-6)


@given(rotations, positions, points)
def test_a_depth_bias_moves_the_point_along_its_ray(
    rotation: Float64Array, position_m: Float64Array, point_s: Float64Array
) -> None:
    view = view_of(rotation, position_m)
    layers, _ = _layers_after(view, point_s)
    z = point_s[2]

    def height(longer_m: float) -> float:
        return float(view.T_terrain_sensor.apply(point_s * (z + longer_m) / z)[2])

    expected = _slope(height) * (0.003 + 0.002 * z * z)
    assert layers.systematic_bias_m[0, 0] == pytest.approx(expected, abs=1e-6)


@given(rotations, points)
def test_constant_errors_that_are_known_to_be_zero_move_nothing(
    rotation: Float64Array, point_s: Float64Array
) -> None:
    settings = MapSettings(resolution_m=0.01)
    plain = DepthNoiseModel("plain", axial_offset_m=0.01)
    view = view_of(rotation)
    cell = np.floor(view.T_terrain_sensor.apply(point_s)[:2] / 0.01).astype(int)
    window = CellWindow(int(cell[0]), int(cell[1]), 1, 1)
    frame = FrameReducer(CAMERA, plain, settings).frame_constants(view, window, (0, 0))
    layers = empty_layers(1, 1)
    fuse(sums_of([1.0], 1.0), frame, fusion_constants(settings), layers, at_rest())
    for name in ("a", "b", "c", "bias"):
        assert getattr(layers, f"systematic_{name}_m")[0, 0] == 0.0


@given(st.floats(0.3, 3.0), st.floats(-1.0, 1.0))
def test_a_level_camera_has_the_textbook_sensitivities(ahead_m: float, aside_m: float) -> None:
    """Looking along x of T: pitch is the optical x axis, roll the optical z axis."""
    optical = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    assume(abs(aside_m) < 0.5 * ahead_m)
    point_s = np.array([-aside_m, 0.4, ahead_m])
    layers, _ = _layers_after(view_of(optical), point_s)
    assert layers.systematic_a_m[0, 0] == pytest.approx(MOUNT_RAD * ahead_m, abs=1e-6)
    assert layers.systematic_b_m[0, 0] == pytest.approx(0.0, abs=1e-6)
    assert layers.systematic_c_m[0, 0] == pytest.approx(MOUNT_RAD * aside_m, abs=1e-6)


def test_the_middle_of_a_coarse_cell_is_never_nearer_than_the_range() -> None:
    """A reading ahead, in a cell whose middle is beside the camera."""
    settings = MapSettings(resolution_m=0.5)
    noise = DepthNoiseModel("biased", axial_offset_m=0.01, bias_sigma_m=0.01)
    optical = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    frame = FrameReducer(CAMERA, noise, settings).frame_constants(
        view_of(optical, (0.25, 0.25, 0.4)), CellWindow(0, 0, 1, 1), (0, 0)
    )
    layers = empty_layers(1, 1)
    fuse(sums_of([-0.4], 1.0), frame, fusion_constants(settings), layers, at_rest())
    assert layers.systematic_bias_m[0, 0] == pytest.approx(-0.4 / 0.4 * 0.01)
