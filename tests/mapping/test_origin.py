"""Maps that begin where their rover stood, against a truth with an origin of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mapping.errors import MappingError
from mapping.geometry import RigidTransform
from mapping.judging.origin import in_frame_of, origin_name, start_origin
from mapping.judging.truth import Truth, evaluate_truth
from tests.mapping.test_rover_view import at, plane_map, plane_truth, track

# The start in the truth's frame; roll and pitch are not part of the map's frame.
START = RigidTransform(
    Rotation.from_euler("ZYX", [0.7, 0.05, -0.02]).as_matrix(), np.array([0.5, -0.3, 0.065])
)
UPRIGHT = RigidTransform(Rotation.from_euler("z", 0.7).as_matrix(), START.translation_m)


def _truth() -> Truth:
    return plane_truth(track(START, START))


def test_a_map_in_the_frame_of_its_start_is_right_there() -> None:
    map_ = plane_map(UPRIGHT.inverse())
    assert evaluate_truth(map_, _truth()).rmse_m > 0.05
    origin = start_origin(_truth(), None)
    assert (origin.x_m, origin.y_m, origin.z_m) == tuple(START.translation_m)
    assert origin.yaw_rad == pytest.approx(0.7)
    scores = evaluate_truth(map_, in_frame_of(_truth(), origin))
    assert scores.cells == map_.known.sum()
    assert scores.max_m < 1e-6
    # The true poses have come along.
    assert scores.relative["at_end"].max_m < 1e-6


def test_poses_that_begin_elsewhere_say_where_the_map_begins() -> None:
    believed = at(0.2, 0.1, z_m=0.3)
    origin = start_origin(_truth(), track(believed, believed))
    expected = START.translation_m - UPRIGHT.rotation @ believed.translation_m
    np.testing.assert_allclose([origin.x_m, origin.y_m, origin.z_m], expected, atol=1e-12)
    assert "z -0.235 m, heading 40.11 deg" in origin.line()


def test_visible_points_turn_with_the_truth() -> None:
    truth = replace(_truth(), visible=np.hypot(*np.meshgrid(_truth().x_m, _truth().y_m)) < 1.0)
    turned = in_frame_of(truth, start_origin(truth, None))
    assert turned.visible is not None
    x_m, y_m = np.meshgrid(turned.x_m, turned.y_m)
    centre = UPRIGHT.inverse().translation_m
    far = np.hypot(x_m - centre[0], y_m - centre[1]) - 1.0
    assert turned.visible[far < -0.05].all()
    assert not turned.visible[far > 0.05].any()


@pytest.mark.parametrize(
    ("source", "name"), [("mocap+alignment", "world"), ("ego-motion+alignment", "start")]
)
def test_the_map_says_where_its_origin_is(source: str, name: str) -> None:
    map_ = replace(plane_map(at(0.0, 0.0)), attributes={"setting_pose_source": source})
    assert origin_name(map_) == name


def test_no_start_without_poses() -> None:
    with pytest.raises(MappingError, match="begins where its rover stood"):
        start_origin(plane_truth(None), None)
    with pytest.raises(MappingError, match="no pose at a time of the truth"):
        start_origin(_truth(), track(at(0.0, 0.0), at(0.1, 0.0), start_ns=0))
