"""Frames from one place: how they are counted, and what the update makes of them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mapping.geometry import RigidTransform, UncertainPose
from mapping.motion.repeats import Repeats
from tests.mapping.cells import Cell, Seen

Float64Array = NDArray[np.float64]

AT_REST = np.zeros((50, 3))
OPEN_GATE = {"gate_sigma": 1e6}


def _counted(
    way_m: Float64Array, turned_rad: Float64Array, sigma: tuple[float, float] = (0.0, 0.0)
) -> list[int]:
    """Return the repeats of cameras at these places, turned by these rotation vectors."""
    repeats = Repeats(jittering=sigma != (0.0, 0.0))
    covariance = np.diag(np.repeat(np.square(sigma), 3))
    found = []
    for position, turn in zip(way_m, turned_rad, strict=True):
        pose = RigidTransform(Rotation.from_rotvec(turn).as_matrix(), position)
        found.append(repeats.count(pose, UncertainPose(0, pose, covariance)))
    return found


def _moving(step: tuple[float, float, float]) -> Float64Array:
    way: Float64Array = np.arange(50)[:, np.newaxis] * np.array(step)
    return way


def test_at_rest_every_frame_is_alike() -> None:
    assert _counted(AT_REST, AT_REST) == list(range(50))


@pytest.mark.parametrize(
    ("step_m", "step_rad", "alike"),
    [
        ((0.03, 0.0, 0.0), (0.0, 0.0, 0.0), 0),
        ((0.0, 0.0, 0.01), (0.0, 0.0, 0.0), 2),
        ((0.0, 0.0, 0.0), (0.0, 0.004, 0.0), 0),
        ((0.0, 0.0, 0.0), (0.001, 0.0, 0.0), 3),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.004), 5),  # about the vertical
    ],
)
def test_small_steps_add_up(
    step_m: tuple[float, float, float], step_rad: tuple[float, float, float], alike: int
) -> None:
    found = _counted(_moving(step_m), _moving(step_rad))
    assert found == [k % (alike + 1) for k in range(50)]


def test_the_noise_of_recorded_poses_is_no_motion() -> None:
    random = np.random.default_rng(1)
    sigma = (0.01, 0.005)
    way, turned = (s * random.standard_normal((300, 3)) for s in sigma)
    assert max(_counted(way, turned)) < 20  # taken for motion
    assert sum(count == 0 for count in _counted(way, turned, sigma)) < 15


def _rested(frames: int, repeats: bool, pixels: int, share: float, white_m: float) -> Cell:
    """Return a cell that a resting camera saw, with 4 mm the same in all of its frames."""
    random = np.random.default_rng(7)
    cell = Cell(**OPEN_GATE)
    own_m2 = 0.004**2 + white_m**2
    for k in range(frames):
        seen = Seen(0.004 + white_m * random.standard_normal(), own_m2, offsets_m=[0.0] * pixels)
        cell.see(seen, repeats=float(k) if repeats else 0.0, fixed_share=share)
    return cell


def test_what_frames_at_rest_have_alike_is_not_averaged_away_and_the_rest_is() -> None:
    white_m = 0.008
    share = 0.004**2 / (0.004**2 + white_m**2)
    cell = _rested(200, repeats=True, pixels=50, share=share, white_m=white_m)
    assert cell.variance_m2 == pytest.approx(0.004**2 + white_m**2 / 200, rel=1e-3)
    # All frames count alike: the height is their mean.
    assert cell.elevation_m == pytest.approx(0.004, abs=3.0 * white_m / np.sqrt(200))
    bold = _rested(200, repeats=False, pixels=50, share=share, white_m=white_m)
    assert bold.variance_m2 < 0.1 * cell.variance_m2


def test_a_cell_that_one_image_row_grazes_learns_nothing_from_a_repeated_frame() -> None:
    cell = _rested(100, repeats=True, pixels=1, share=0.0, white_m=0.0)
    assert cell.variance_m2 == pytest.approx(0.004**2, rel=1e-6)
    assert cell.elevation_m == pytest.approx(0.004, abs=1e-9)
    assert cell.frames == 100


def test_what_was_known_before_the_rest_stays_known() -> None:
    cell = Cell(**OPEN_GATE)
    for _ in range(20):
        cell.see(Seen(0.0, 1e-5, offsets_m=[0.0] * 50))
    before = cell.variance_m2
    for k in range(300):
        cell.see(Seen(0.004, 1e-5, offsets_m=[0.0] * 50), repeats=float(k), fixed_share=1.0)
        assert cell.variance_m2 <= before * (1.0 + 1e-6)
    assert 0.3 * before < cell.variance_m2
    assert abs(cell.elevation_m) < 0.004 * 0.5
