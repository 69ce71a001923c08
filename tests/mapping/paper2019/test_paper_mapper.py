"""The printed map from samples: its numbers, its place beside the corrected one, its refusals."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from acquisition.messages.frames import (
    BASE_FRAME,
    MOCAP_BODY_FRAME,
    StaticTransform,
    StaticTransforms,
)
from drivers.samples import DepthFrame, Sample, frozen_array
from mapping.cells.elevation_map import CellState, ElevationMap
from mapping.errors import MappingError
from mapping.mapper import Mapper
from mapping.noise import constant_noise
from mapping.paper2019.faults import FAULTS, describe_faults
from mapping.paper2019.paper_mapper import PaperMapper
from mapping.settings import MapSettings
from tests.mapping.scenes import CAMERA, floor_frame, looking, millimetres, mount, pose_sample

SETTINGS = MapSettings(resolution_m=0.05)
NOISE = constant_noise(0.01)
DOWN = looking(0.0, 90.0)


def _map(mapper: Mapper, frames: int, covariance: np.ndarray) -> ElevationMap:
    """Look straight down on a floor 1 m below, so that a pixel's height sigma is the noise's."""
    mapper.add(mount())
    for n in range(frames):
        z_m = np.full((CAMERA.height_px, CAMERA.width_px), 1.0)
        samples: list[Sample] = [
            pose_sample(n * 100_000_000, (0.0, 0.0, 1.0), DOWN, covariance),
            DepthFrame(n * 100_000_000, millimetres(z_m), CAMERA, n),
        ]
        for sample in samples:
            mapper.add(sample)
    mapper.finish()
    return mapper.elevation_map()


def test_every_pixel_counts_as_independent() -> None:
    """Sigma 10 mm, n pixels, three frames: variance 1e-4 / n by eq. 15, whatever they share."""
    map_ = _map(PaperMapper(SETTINGS, NOISE), 3, np.zeros((6, 6)))
    seen = map_.known
    assert np.abs(map_.elevation_m[seen]).max() < 1e-6
    np.testing.assert_allclose(map_.variance_m2[seen], 1e-4 / map_.pixels[seen], rtol=1e-4)
    assert (map_.frames[seen] == 3).all()


def test_the_rotation_counts_for_every_pixel_as_if_drawn_afresh() -> None:
    """Eq. 6: 1e-4 + y^2 s_roll^2 for each pixel, divided by their number; first frame only."""
    covariance = np.diag([0.0, 0.0, 0.0, 1e-2, 0.0, 0.0])
    map_ = _map(PaperMapper(SETTINGS, NOISE), 1, covariance)
    pixel_m2 = 1e-4 + 1e-2 * np.square(map_.y_m)[:, np.newaxis]
    expected = np.broadcast_to(pixel_m2, map_.pixels.shape)[map_.known] / map_.pixels[map_.known]
    np.testing.assert_allclose(map_.variance_m2[map_.known], expected, rtol=1e-4)


def test_motion_raises_what_is_not_measured_again() -> None:
    """Two frames here, eight 5 m away with 10 mm of z each: eight steps of 1e-4 by eq. 28."""
    mapper = PaperMapper(SETTINGS, NOISE)
    covariance = np.diag([0.0, 0.0, 1e-4, 0.0, 0.0, 0.0])
    first = _map(mapper, 2, np.zeros((6, 6)))
    for n in range(2, 10):
        mapper.add(pose_sample(n * 100_000_000, (5.0, 0.0, 1.0), DOWN, covariance))
        mapper.add(floor_frame(n * 100_000_000, 1.0, DOWN))
    last = mapper.elevation_map()
    cell = np.ix_(np.isin(last.y_m, first.y_m), np.isin(last.x_m, first.x_m))
    grown = last.variance_m2[cell] - first.variance_m2
    np.testing.assert_allclose(grown[first.known], 8e-4, rtol=1e-3)


def _after_an_unsure_turn(mapper: Mapper) -> float:
    """Map a floor from a tilted camera, leave with 0.1 rad of yaw sigma; return the worst sigma."""
    rotation = looking(0.0, 50.0)
    covariance = np.diag([0.0, 0.0, 0.0, 0.0, 0.0, 1e-2])
    mapper.add(mount())
    for n, (x_m, noise) in enumerate([(0.0, 0.0), (0.0, 0.0), (9.0, 1.0)]):
        mapper.add(pose_sample(n, (x_m, 0.0, 1.0), rotation, noise * covariance))
        mapper.add(floor_frame(n, 1.0, rotation))
    map_ = mapper.elevation_map()
    return float(np.nanmax(map_.sigma_m[:, map_.x_m < 4.0]))


def test_a_yaw_error_leaks_into_heights_unless_the_rovers_frame_is_upright() -> None:
    """The tracked body is the camera, 50 degrees down; base_link, where it is known, is upright."""
    assert _after_an_unsure_turn(PaperMapper(SETTINGS, NOISE)) > 0.05
    upright = PaperMapper(SETTINGS, NOISE)
    turn = Rotation.from_matrix(looking(0.0, 50.0).T).as_quat(scalar_first=True)
    base = StaticTransform(
        MOCAP_BODY_FRAME, BASE_FRAME, frozen_array((0, 0, 0), (3,)), frozen_array(turn, (4,))
    )
    upright.add(StaticTransforms(0, (base,)))
    assert _after_an_unsure_turn(upright) < 0.01


def test_its_map_says_what_it_is() -> None:
    map_ = _map(PaperMapper(SETTINGS, NOISE), 3, np.zeros((6, 6)))
    assert map_.attributes["method"] == "paper2019"
    assert all(fault in str(map_.attributes["method_faults"]) for fault in FAULTS)
    assert "\n" not in describe_faults()


def test_its_arrays_are_those_that_the_kernels_are_compiled_for_beforehand() -> None:
    """numba compiles once more, for seconds and without a word, for a view with steps."""
    map_ = _map(PaperMapper(SETTINGS, NOISE), 1, np.zeros((6, 6)))
    layers = {item.name: getattr(map_, item.name) for item in fields(map_)}
    floats = {name: a for name, a in layers.items() if getattr(a, "dtype", None) == np.float32}
    assert len(floats) >= 8
    assert [name for name, layer in floats.items() if not layer.flags.c_contiguous] == []


def test_states_follow_the_same_limits() -> None:
    map_ = _map(PaperMapper(SETTINGS, NOISE), 1, np.zeros((6, 6)))
    assert set(np.unique(map_.state)) <= {CellState.UNKNOWN, CellState.UNCONFIRMED}
    vague = _map(PaperMapper(SETTINGS, constant_noise(0.5)), 2, np.zeros((6, 6)))
    assert (vague.state == CellState.UNCERTAIN).any()


def test_no_window_no_reading_and_jumps_are_refused() -> None:
    with pytest.raises(MappingError, match="paper2019 has no window: give --grid growing"):
        PaperMapper(MapSettings(grid="scrolling"), NOISE)
    with pytest.raises(MappingError, match="the stream holds no depth frame"):
        PaperMapper(SETTINGS, NOISE).elevation_map()
    far = PaperMapper(SETTINGS, NOISE)
    far.add(mount())
    far.add(pose_sample(0, (0.0, 0.0, 30.0), DOWN))
    far.add(floor_frame(0, 30.0, DOWN))
    with pytest.raises(MappingError, match="no depth reading reached the map"):
        far.elevation_map()
    far.add(pose_sample(1, (5e4, 5e4, 1.0), DOWN))
    with pytest.raises(MappingError, match="check the poses for jumps"):
        far.add(floor_frame(1, 1.0, DOWN))
