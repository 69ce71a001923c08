"""The tree of fixed transforms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from acquisition.messages.frames import StaticTransform
from drivers.samples import frozen_array
from mapping.errors import MappingError
from mapping.mapper_counts import MapperCounts
from mapping.mounts import MountTree


def _transform(parent: str, child: str, x_m: float, turn_deg: float = 0.0) -> StaticTransform:
    quat = Rotation.from_euler("z", turn_deg, degrees=True).as_quat(scalar_first=True)
    return StaticTransform(
        parent, child, frozen_array((x_m, 0.0, 0.0), (3,)), frozen_array(quat, (4,))
    )


def test_a_chain_is_followed_in_both_directions_in_any_order() -> None:
    tree = MountTree()
    tree.add([_transform("rover", "mast", 1.0, 90.0)])
    tree.add([_transform("mast", "camera", 0.5), _transform("rover", "body", 0.2)])
    found = tree.lookup("body", "camera")
    # camera origin: 0.5 m along the mast's x, which is the rover's y; the body is 0.2 m ahead.
    np.testing.assert_allclose(found.translation_m, [0.8, 0.5, 0.0], atol=1e-12)
    back = tree.lookup("camera", "body") @ found
    np.testing.assert_allclose(back.translation_m, np.zeros(3), atol=1e-12)
    np.testing.assert_allclose(back.rotation, np.eye(3), atol=1e-12)


def test_a_later_transform_replaces_an_earlier_one_and_is_counted_if_it_differs() -> None:
    counts = MapperCounts()
    tree = MountTree(counts)
    tree.add([_transform("body", "camera", 1.0), _transform("body", "camera", 2.0)])
    assert tree.lookup("body", "camera").translation_m[0] == 2.0
    assert tree.lookup("camera", "body").translation_m[0] == -2.0
    tree.add([_transform("camera", "body", -3.0)])
    assert tree.lookup("body", "camera").translation_m[0] == 3.0
    assert counts.mounts_replaced == 2
    tree.add([_transform("body", "camera", 3.0), _transform("camera", "body", -3.0)])
    assert counts.mounts_replaced == 2
    tree.add([_transform("body", "camera", 3.0, 1.0)])
    assert counts.mounts_replaced == 3


def test_a_frame_is_in_itself_without_any_transform() -> None:
    np.testing.assert_array_equal(MountTree().lookup("a", "a").rotation, np.eye(3))


def test_frames_that_nothing_connects_are_named() -> None:
    tree = MountTree()
    with pytest.raises(MappingError, match=r"does not connect body with camera \(frames found: no"):
        tree.lookup("body", "camera")
    tree.add([_transform("body", "wheel", 1.0), _transform("mast", "camera", 1.0)])
    reason = r"\(frames found: body, camera, mast, wheel\); record the mount of the depth sensor"
    with pytest.raises(MappingError, match=reason):
        tree.lookup("body", "camera")


def test_a_mount_that_is_none_is_refused() -> None:
    bad = StaticTransform("body", "camera", np.zeros(3), np.array([np.nan, 0.0, 0.0, 0.0]))
    with pytest.raises(MappingError, match="mount of camera in body: quaternion wxyz"):
        MountTree().add([bad])
