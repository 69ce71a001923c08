"""Things that come and go, thin things, what hangs above the ground, and the rover itself."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from acquisition.messages.frames import (
    BASE_FRAME,
    DEPTH_OPTICAL_FRAME,
    StaticTransform,
    StaticTransforms,
)
from drivers.samples import DepthFrame, frozen_array
from mapping.errors import MappingError
from mapping.judging.evaluation import CONFIRMED
from mapping.mapper import Mapper
from mapping.noise import KINECT_V1
from mapping.settings import MapSettings
from tests.mapping.boxes import Box, Stage
from tests.mapping.scenes import BODY_FROM_OPTICAL, floor_frame, mount, pose_sample

# Frames come ten a second.
ONE_SECOND, TWO_SECONDS = 10, 20
BOX: Box = (1.5, -0.2, 0.0, 1.7, 0.2, 0.35)
# Hides the ground where the box stands, but not the box; the rays above it end at the wall.
SILL: Box = (1.2, -1.0, 0.0, 1.24, 1.0, 0.2)
WALL: Box = (3.0, -3.0, 0.0, 3.2, 3.0, 2.0)
PILLAR: Box = (1.52, -0.1, 0.0, 1.7, 0.1, 2.0)
PILLAR_FRONT: Box = (1.52, -0.08, 0.0, 1.56, 0.08, 2.0)
TABLE_TOP: Box = (1.2, -0.4, 0.9, 1.8, 0.4, 0.95)


def _stage(**settings: Any) -> Stage:
    mapper = Mapper(MapSettings(**settings), KINECT_V1)
    mapper.add(mount())
    return Stage(mapper)


def _see(stage: Stage, frames: int, *boxes: Box, **view: Any) -> None:
    for _ in range(frames):
        stage.see(boxes, **view)


def _under(box: Box, stage: Stage) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    return stage.heights(box)


def test_a_box_on_open_ground_is_shown_and_gone_in_time() -> None:
    stage = _stage()
    _see(stage, TWO_SECONDS)
    _see(stage, ONE_SECOND, BOX)
    assert np.abs(_under(BOX, stage)[0] - 0.35).max() < 0.02
    _see(stage, TWO_SECONDS, BOX)
    _see(stage, TWO_SECONDS)
    assert np.abs(_under(BOX, stage)[0]).max() < 0.02


def test_a_pillar_whose_top_is_out_of_view_is_shown_and_gone_in_time() -> None:
    """All that is seen of it are readings from 0 to 1 m height in one row of cells."""
    stage = _stage()
    _see(stage, TWO_SECONDS)
    _see(stage, ONE_SECOND, PILLAR, pitch_deg=5.0)
    assert (_under(PILLAR_FRONT, stage)[0] > 0.4).all()
    _see(stage, 8 * ONE_SECOND, PILLAR, pitch_deg=5.0)  # long seen, it is no longer doubted
    _see(stage, TWO_SECONDS)
    assert np.abs(_under(PILLAR_FRONT, stage)[0]).max() < 0.02


def test_a_box_whose_ground_stays_hidden_goes_when_it_is_seen_through() -> None:
    stage = _stage()
    _see(stage, ONE_SECOND, SILL, WALL)
    _see(stage, ONE_SECOND, SILL, WALL, BOX)
    assert np.abs(_under(BOX, stage)[0] - 0.35).max() < 0.02
    sill = _under(SILL, stage)
    _see(stage, TWO_SECONDS, SILL, WALL)
    assert np.isnan(_under(BOX, stage)[0]).all()
    assert stage.mapper.counts.cleared >= 40
    np.testing.assert_array_equal(_under(SILL, stage)[1], sill[1])


def test_without_the_clean_up_that_ghost_stays() -> None:
    stage = _stage(seen_through_frames=0)
    _see(stage, ONE_SECOND, SILL, WALL, BOX)
    _see(stage, TWO_SECONDS, SILL, WALL)
    assert (_under(BOX, stage)[0] > 0.3).all()
    assert stage.mapper.counts.cleared == 0


@pytest.mark.parametrize("needed", [1, 7])
def test_a_ghost_goes_after_exactly_so_many_frames(needed: int) -> None:
    stage = _stage(seen_through_frames=needed)
    _see(stage, ONE_SECOND, SILL, WALL, BOX)
    _see(stage, needed - 1, SILL, WALL)
    assert not np.isnan(_under(BOX, stage)[0]).any()
    _see(stage, 1, SILL, WALL)
    assert np.isnan(_under(BOX, stage)[0]).all()


def test_a_reading_in_the_cell_takes_one_back() -> None:
    stage = _stage(seen_through_frames=3)
    _see(stage, ONE_SECOND, SILL, WALL, BOX)
    for _ in range(5):
        _see(stage, 1, SILL, WALL)
        _see(stage, 1, SILL, WALL, BOX)
    assert (_under(BOX, stage)[0] > 0.3).all()


def test_looking_elsewhere_or_into_nothing_forgets_nothing() -> None:
    curtain: Box = (0.6, -1.0, 0.0, 0.7, 1.0, 1.5)
    stage = _stage(seen_through_frames=1)
    _see(stage, ONE_SECOND, SILL, WALL, BOX)
    _see(stage, 3, WALL, yaw_deg=120.0)
    _see(stage, 3, SILL, pitch_deg=-20.0)  # the sky: no reading
    _see(stage, 3, curtain, SILL, WALL)
    assert (_under(BOX, stage)[0] > 0.3).all()


@pytest.mark.parametrize(("width_m", "offset_m"), [(0.04, 0.02), (0.04, 0.0), (0.08, 0.01)])
def test_a_thin_post_survives_a_drive_past_it(width_m: float, offset_m: float) -> None:
    """One or two cells wide, on the grid's lines and between them, from 2 m away to beside it."""
    x = 1.0 + offset_m
    post: Box = (x, 0.1, 0.0, x + width_m, 0.1 + width_m, 0.5)
    stage = _stage(seen_through_frames=1)
    for n in range(9):
        stage.see([post, WALL], (-1.0 + 0.25 * n, 0.0, 0.4 + 0.1 * np.sin(n)), 5.0 * np.sin(n))
    around: Box = (x - 0.03, 0.07, 0.0, x + width_m + 0.03, 0.13 + width_m, 0.5)
    assert np.nanmax(_under(around, stage)[0]) > 0.1
    assert stage.mapper.counts.cleared == 0


def test_under_a_table_the_ground_stays_the_ground() -> None:
    """Seen from above its top, from below it, and both in turn; the camera is 1.2 or 0.5 m up."""
    stage = _stage(overhang_clearance_m=0.6)
    _see(stage, 5, TABLE_TOP, position_m=(0.0, 0.0, 0.5))
    found = []
    for height_m in (1.2, 0.5) * 4:
        _see(stage, 5, TABLE_TOP, position_m=(0.0, 0.0, height_m))
        found.append(_under(TABLE_TOP, stage)[0])
    assert np.abs(found).max() < 0.02
    assert stage.mapper.counts.readings_overhanging > 1000


def test_without_a_clearance_it_flickers() -> None:
    stage = _stage()
    _see(stage, 5, TABLE_TOP, position_m=(0.0, 0.0, 0.5))
    _see(stage, 5, TABLE_TOP, position_m=(0.0, 0.0, 1.2))
    assert (_under(TABLE_TOP, stage)[0] > 0.5).any()
    assert stage.mapper.counts.readings_overhanging == 0


def test_a_table_seen_first_from_above_gives_way_to_the_ground() -> None:
    stage = _stage(overhang_clearance_m=0.6)
    _see(stage, 5, TABLE_TOP, position_m=(0.0, 0.0, 1.2), pitch_deg=0.0)
    middle: Box = (1.3, -0.3, 0.0, 1.7, 0.3, 1.0)
    assert (_under(middle, stage)[0] > 0.9).any()
    _see(stage, 5, TABLE_TOP, position_m=(0.0, 0.0, 0.5))
    _see(stage, 5, TABLE_TOP, position_m=(0.0, 0.0, 1.2))
    assert np.abs(_under(middle, stage)[0]).max() < 0.02


def test_what_stands_on_the_ground_is_no_overhang() -> None:
    """The camera is below the clearance: it sees the flank of anything that tall."""
    stage = _stage(overhang_clearance_m=0.6)
    _see(stage, TWO_SECONDS)
    _see(stage, ONE_SECOND, PILLAR, pitch_deg=5.0)
    assert (_under(PILLAR_FRONT, stage)[0] > 0.25).all()


def _rover_with_arm(boxes_m: Any, mounts: StaticTransforms) -> Mapper:
    """Map frames with an arm 0.6 m in front of the camera, over a floor 0.4 m below."""
    mapper = Mapper(MapSettings(body_boxes_m=boxes_m), KINECT_V1)
    mapper.add(mounts)
    for n in range(3):
        frame = floor_frame(n * 100_000_000)
        depth_mm = frame.depth_mm.copy()
        depth_mm[20:28, 10:30] = 600
        depth_mm.flags.writeable = False
        mapper.add(pose_sample(frame.t_ns))
        mapper.add(DepthFrame(frame.t_ns, depth_mm, frame.camera, n))
    return mapper


def _mounts() -> StaticTransforms:
    """The camera is the tracked body; the rover's origin is 0.1 m behind it, axes forward, left."""
    position = frozen_array((0.1, 0.0, 0.0), (3,))
    half = 0.5
    # x right, y down, z forward to x forward, y left, z up.
    quat = frozen_array((half, -half, half, -half), (4,))
    camera = StaticTransform(BASE_FRAME, DEPTH_OPTICAL_FRAME, position, quat)
    return StaticTransforms(0, (*mount().transforms, camera))


def test_the_quaternion_of_the_mount_is_the_usual_one() -> None:
    """A check of the scene: a point straight ahead of the camera is ahead of the rover."""
    np.testing.assert_allclose(BODY_FROM_OPTICAL @ (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))


def test_readings_inside_the_rovers_own_boxes_are_dropped_and_counted() -> None:
    arm = (0.65, -0.4, -0.06, 0.75, 0.4, 0.06)
    mapper = _rover_with_arm([arm], _mounts())
    assert mapper.counts.readings_own_body == 3 * 8 * 20
    without = _rover_with_arm([], _mounts())
    assert without.counts.readings == mapper.counts.readings + 3 * 8 * 20
    confirmed = np.isin(mapper.elevation_map().state, CONFIRMED)
    assert np.abs(mapper.elevation_map().elevation_m[confirmed]).max() < 0.002
    assert np.nanmax(without.elevation_map().elevation_m) > 0.02


def test_only_what_lies_inside_is_dropped() -> None:
    elsewhere = (0.65, 0.5, -0.2, 0.75, 0.9, 0.2)
    assert _rover_with_arm([elsewhere], _mounts()).counts.readings_own_body == 0


def test_boxes_need_the_rover_frame() -> None:
    with pytest.raises(MappingError, match="does not connect base_link with depth_optical_frame"):
        _rover_with_arm([(0, 0, 0, 1, 1, 1)], mount())
