"""Which cells count as visible, and where the camera sits that sees them."""

from __future__ import annotations

import numpy as np
import pytest

from simulation.devices.camera_mount import BODY_FROM_OPTICAL, on_rover
from simulation.errors import SimulationError
from simulation.truth import SeenCells


def test_cells_with_four_rays_are_visible() -> None:
    seen = SeenCells(0.5)
    seen.add(np.array([[0.1, 0.1], [0.2, 0.4], [-0.1, 0.9]]))
    seen.add(np.empty((0, 2)))
    seen.add(np.array([[0.3, 0.3], [0.49, 0.0], [-0.1, 0.6], [-0.4, 0.7]]))
    truth = seen.truth(lambda x, y: 10.0 * x + y)
    assert truth.x_m.tolist() == [-0.25, 0.25]
    assert truth.y_m.tolist() == [0.25, 0.75]
    assert truth.visible.tolist() == [[False, True], [False, False]]
    assert truth.height_m.tolist() == [[-2.25, 2.75], [-1.75, 3.25]]
    with pytest.raises(SimulationError, match="cells of 0"):
        SeenCells(0.0)


def test_the_camera_looks_ahead_and_down_from_the_rover() -> None:
    position, rotation = np.array([1.0, 2.0, 3.0]), np.eye(3)
    place, looking = on_rover().camera_pose(position, rotation)
    np.testing.assert_allclose(place, [1.16, 2.0, 3.4])
    forward = looking @ [0.0, 0.0, 1.0]
    np.testing.assert_allclose(forward, [np.cos(0.43633), 0.0, -np.sin(0.43633)], atol=1e-5)
    np.testing.assert_allclose(BODY_FROM_OPTICAL @ [1.0, 0.0, 0.0], [0.0, -1.0, 0.0])
