"""The filters' early tests leave out work, never a reading: both agree with every reading's own."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drivers.samples import CameraIntrinsics
from mapping.cells.grid import GrowingGrid
from mapping.change.overhang import drop_overhangs
from mapping.change.own_body import drop_own_body
from mapping.geometry import RigidTransform, UncertainPose
from mapping.measurement import FrameReducer, View
from mapping.noise import NGUYEN_2012
from mapping.settings import MapSettings

CAMERA = CameraIntrinsics(32, 24, 30.0, 30.0, 15.5, 11.5)
OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def _reducer(seed: int, settings_: MapSettings) -> FrameReducer:
    reducer = FrameReducer(CAMERA, NGUYEN_2012, settings_)
    random = np.random.default_rng(seed)
    depth_mm = random.integers(300, random.integers(900, 4500), (24, 32)).astype(np.uint16)
    reducer.load(depth_mm)
    return reducer


def _view(pitch_rad: float, yaw_rad: float) -> View:
    turn = Rotation.from_euler("ZY", [yaw_rad, pitch_rad]).as_matrix() @ OPTICAL
    pose = RigidTransform(turn, np.array([0.3, -0.2, 0.7]))
    return View(UncertainPose(0, pose, np.zeros((6, 6))), pose)


def _points(reducer: FrameReducer, pose: RigidTransform) -> np.ndarray:
    readings = reducer.readings
    k = readings.margin_px
    z = readings.z_m[k:-k, k:-k].astype(float)
    x, y = np.meshgrid(readings.ray_x.astype(float), readings.ray_y.astype(float))
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) * z[..., np.newaxis]
    points = rays @ pose.rotation.T + pose.translation_m
    points[z == 0.0] = np.nan
    return np.asarray(points)


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 999),
    st.floats(-0.5, 1.5),
    st.floats(-3.0, 3.0),
    st.tuples(*[st.floats(-1.5, 1.5)] * 3),
)
def test_a_reading_in_a_box_is_dropped_and_no_other(
    seed: int, pitch_rad: float, yaw_rad: float, corner_m: tuple[float, float, float]
) -> None:
    reducer = _reducer(seed, MapSettings())
    mount = _view(pitch_rad, yaw_rad).T_terrain_sensor
    box = np.array([*corner_m, *(np.array(corner_m) + 0.7)])
    points = _points(reducer, mount)
    inside = ((points >= box[:3]) & (points <= box[3:])).all(axis=-1)
    dropped = drop_own_body(reducer.readings, [box.tolist()], mount)
    assert dropped == np.count_nonzero(inside)
    left = np.isfinite(_points(reducer, mount)[..., 0])
    np.testing.assert_array_equal(left, np.isfinite(points[..., 0]) & ~inside)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 999), st.floats(-0.2, 1.5), st.floats(0.05, 1.5), st.floats(-1.0, 0.5))
def test_a_reading_above_its_ceiling_is_dropped_and_no_other(
    seed: int, pitch_rad: float, clearance_m: float, floor_m: float
) -> None:
    wanted = MapSettings(resolution_m=0.2, overhang_clearance_m=clearance_m)
    reducer, view, grid = _reducer(seed, wanted), _view(pitch_rad, 0.4), GrowingGrid(wanted)
    window = grid.prepare(reducer.footprint(view), 0.0, 0.0)
    constants = reducer.frame_constants(view, window, grid.position(window))
    layers = grid.layers
    known = np.random.default_rng(seed).random(layers.frames.shape) < 0.2
    layers.frames[known] = layers.pixels[known] = 9
    layers.elevation_m[known] = floor_m
    points = _points(reducer, view.T_terrain_sensor)
    seen = np.isfinite(points[..., 0])
    column, row = (np.floor(points[seen][:, k] / 0.2).astype(int) for k in (0, 1))
    place = row - grid.extent.first_y, column - grid.extent.first_x
    ceiling = np.where(known, floor_m, np.inf)
    np.minimum.at(ceiling, place, points[seen][:, 2])
    high = points[seen][:, 2] > ceiling[place] + clearance_m
    assert drop_overhangs(reducer.readings, view, constants, layers, wanted) == high.sum()
    left = np.isfinite(_points(reducer, view.T_terrain_sensor)[..., 0])
    np.testing.assert_array_equal(left[seen], ~high)
