"""Which cells count as hidden: what lies in a shadow, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from mapping.cells.elevation_map import CellState
from mapping.mapper import Mapper
from mapping.noise import KINECT_V1
from mapping.settings import MapSettings
from tests.mapping.boxes import Box, Stage
from tests.mapping.scenes import mount

# From a camera at 0.5 m, the shadow of its upper edges at 0.2 m reaches 2/3 of their distance on.
BOX: Box = (1.2, -0.3, 0.0, 1.4, 0.3, 0.2)
SHADOW: Box = (1.44, -0.2, 0.0, 1.96, 0.2, 0.0)


def _stage(**settings: object) -> Stage:
    mapper = Mapper(MapSettings(**settings), KINECT_V1)  # type: ignore[arg-type] # by name
    mapper.add(mount())
    return Stage(mapper)


def test_the_shadow_of_a_box_is_occluded_and_has_no_height() -> None:
    stage = _stage()
    for _ in range(3):
        stage.see([BOX])
    heights, states = stage.heights(SHADOW)
    assert (states == CellState.OCCLUDED).all()
    assert np.isnan(heights).all()
    map_ = stage.mapper.elevation_map()
    hidden = map_.state == CellState.OCCLUDED
    # A few cells along the edges beside it, but no ground elsewhere.
    x, y = np.meshgrid(map_.x_m, map_.y_m)
    assert (np.abs(y[hidden]) < 0.7).all()
    assert (x[hidden] > 1.1).all()
    assert not map_.known[hidden].any()


def test_a_shadow_that_is_looked_into_later_is_measured() -> None:
    stage = _stage()
    stage.see([BOX])
    for _ in range(3):
        stage.see([BOX], position_m=(1.0, 0.0, 2.0), pitch_deg=60.0)
    heights, states = stage.heights(SHADOW)
    assert (states >= CellState.UNCONFIRMED).all()
    assert (states != CellState.OCCLUDED).all()
    assert np.abs(heights).max() < 0.02


@pytest.mark.parametrize("height_m", [0.2, 0.5, 1.0])
@pytest.mark.parametrize("resolution_m", [0.02, 0.04])
def test_open_ground_hides_nothing_however_low_the_camera(
    height_m: float, resolution_m: float
) -> None:
    stage = _stage(resolution_m=resolution_m)
    for n in range(3):
        stage.see([], position_m=(0.0, 0.0, height_m), pitch_deg=15.0 + n)
    map_ = stage.mapper.elevation_map()
    occluded = np.count_nonzero(map_.state == CellState.OCCLUDED)
    assert occluded <= 0.002 * np.count_nonzero(map_.known)


def test_without_the_visibility_step_nothing_is_marked() -> None:
    stage = _stage(seen_through_frames=0)
    stage.see([BOX])
    assert (stage.heights(SHADOW)[1] == CellState.UNKNOWN).all()
