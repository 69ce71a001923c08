from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.errors import DriverError, EndOfSource
from drivers.samples import DepthFrame, PoseSample, Sample
from simulation.devices.camera_mount import BODY_FROM_OPTICAL, camera_is_body, on_rover
from simulation.devices.depth_camera import DepthCamera
from simulation.devices.kinect import KinectModel, kinect_320
from simulation.drive_source import DriveSource
from simulation.errors import SimulationError
from simulation.ideal_drive import IdealDrive
from simulation.motion import START_NS
from simulation.terrain.height_grid import HeightGrid
from simulation.truth import SeenCells
from simulation.vehicle.scripted_drive import PosePath, ScriptedDrive

QUARTER_TURN = np.sqrt(0.5)


def straight_path(seconds: float = 0.2) -> PosePath:
    """0.4 m/s along x at wheel height, level."""
    t_ns = np.array([0, round(seconds * 1e9)])
    positions = np.array([[0.0, 0.0, 0.1], [0.4 * seconds, 0.0, 0.1]])
    return PosePath(t_ns, positions, np.array([[1.0, 0.0, 0.0, 0.0]] * 2))


def level_ground() -> HeightGrid:
    return HeightGrid(-1.0, -3.0, 0.05, np.zeros((121, 141), np.float32))


def scripted(seed: int = 1) -> ScriptedDrive:
    camera = DepthCamera(level_ground(), kinect_320(), KinectModel(), seed)
    return ScriptedDrive(camera, straight_path(), on_rover())


def ideal(seed: int = 1) -> IdealDrive:
    return IdealDrive(seed, 0.3)


def play(drive: DriveSource) -> list[Sample]:
    samples: list[Sample] = []
    drive.open()
    for _ in range(drive.frames):
        samples.extend(drive.read(0.0))
    with pytest.raises(EndOfSource, match="end of the drive"):
        drive.read(0.0)
    drive.close()
    return samples


def content(sample: Sample) -> bytes:
    assert isinstance(sample, PoseSample | DepthFrame)
    if isinstance(sample, DepthFrame):
        return sample.depth_mm.tobytes()
    return sample.position_m.tobytes() + sample.quat_wxyz.tobytes()


BOTH = pytest.mark.parametrize("make", [scripted, ideal])


@BOTH
def test_a_drive_gives_poses_and_frames_in_order(make: Callable[[int], DriveSource]) -> None:
    samples = play(make(1))
    times = [sample.t_ns for sample in samples]
    assert times == sorted(times)
    poses = [sample for sample in samples if isinstance(sample, PoseSample)]
    frames = [sample for sample in samples if isinstance(sample, DepthFrame)]
    assert [pose.t_ns - START_NS for pose in poses] == [20_000_000 * i for i in range(11)]
    assert [frame.t_ns - START_NS for frame in frames] == [100_000_000 * i for i in range(3)]
    assert [frame.sequence for frame in frames] == list(range(3))
    assert all(frame.depth_mm.any() for frame in frames)


@BOTH
def test_same_seed_same_samples(make: Callable[[int], DriveSource]) -> None:
    first, again, other = ([content(s) for s in play(make(seed))] for seed in (1, 1, 2))
    assert first == again
    assert first != other


@BOTH
def test_a_drive_can_be_opened_again(make: Callable[[int], DriveSource]) -> None:
    drive = make(1)
    with pytest.raises(DriverError, match="before open"):
        drive.read(0.0)
    assert [content(s) for s in play(drive)] == [content(s) for s in play(drive)]
    drive.close()
    drive.close()
    with pytest.raises(DriverError, match="before open"):
        drive.read(0.0)


def test_the_body_is_tracked_and_the_camera_rides_on_it() -> None:
    drive = scripted()
    pose, frame = play(drive)[-2:]
    assert isinstance(pose, PoseSample)
    np.testing.assert_allclose(pose.position_m, [0.08, 0.0, 0.1], atol=1e-12)
    np.testing.assert_allclose(pose.quat_wxyz, [1.0, 0.0, 0.0, 0.0], atol=1e-12)
    assert isinstance(frame, DepthFrame)
    # The optical axis meets the ground 0.5 m below at 25 degrees.
    middle = frame.depth_mm[115:125, 155:165] / 1000.0
    assert np.median(middle) == pytest.approx(0.5 / np.sin(np.radians(25.0)), rel=0.03)


def test_the_truth_is_the_ground_and_what_was_seen_of_it() -> None:
    drive = scripted()
    with pytest.raises(SimulationError, match="saw no ground"):
        drive.truth(0.04, 0.4, 4.0)
    play(drive)
    truth = drive.truth(0.04, 0.4, 4.0)
    assert truth.height_m.shape == truth.visible.shape == (truth.y_m.size, truth.x_m.size)
    assert not truth.height_m.any()
    np.testing.assert_allclose(np.diff(truth.x_m), 0.04)
    np.testing.assert_allclose(truth.x_m / 0.04 % 1.0, 0.5)
    seen_x = truth.x_m[truth.visible.any(axis=0)]
    # The nearest reading is 0.8 m along the axis, in the lower half of the first image.
    assert 0.6 < seen_x.min() < 0.9
    assert seen_x.max() < 0.16 + 0.08 + 4.0
    nearer = drive.truth(0.04, 0.4, 1.5)
    assert nearer.visible.sum() < truth.visible.sum()


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


def test_a_path_is_linear_between_its_poses() -> None:
    path = PosePath(
        np.array([0, 1000, 3000]),
        np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 2.0], [1.0, 4.0, 2.0]]),
        np.array([[1.0, 0, 0, 0], [2.0, 0, 0, 0], [QUARTER_TURN, 0, 0, QUARTER_TURN]]),
    )
    position, rotation = path.at(2000)
    np.testing.assert_allclose(position, [1.0, 2.0, 2.0])
    np.testing.assert_allclose(rotation @ [1.0, 0.0, 0.0], [QUARTER_TURN, QUARTER_TURN, 0.0])
    assert path.duration_ns == 3000


def test_mounts() -> None:
    position, rotation = np.array([1.0, 2.0, 3.0]), np.eye(3)
    np.testing.assert_array_equal(camera_is_body().camera_pose(position, rotation)[0], position)
    place, looking = on_rover().camera_pose(position, rotation)
    np.testing.assert_allclose(place, [1.16, 2.0, 3.4])
    forward = looking @ [0.0, 0.0, 1.0]
    np.testing.assert_allclose(forward, [np.cos(0.43633), 0.0, -np.sin(0.43633)], atol=1e-5)
    np.testing.assert_allclose(BODY_FROM_OPTICAL @ [1.0, 0.0, 0.0], [0.0, -1.0, 0.0])


@pytest.mark.parametrize(
    ("t_ns", "positions", "quats"),
    [
        (np.array([0]), np.zeros((1, 3)), np.ones((1, 4))),
        (np.array([1, 2]), np.zeros((2, 3)), np.ones((2, 4))),
        (np.array([0, 0]), np.zeros((2, 3)), np.ones((2, 4))),
        (np.array([0, 1]), np.zeros((3, 3)), np.ones((2, 4))),
        (np.array([0, 1]), np.zeros((2, 3)), np.ones((2, 3))),
        (np.array([0, 1]), np.zeros((2, 3)), np.zeros((2, 4))),
        (np.array([0, 1]), np.full((2, 3), np.nan), np.ones((2, 4))),
    ],
)
def test_impossible_paths_are_refused(
    t_ns: NDArray[np.int64], positions: NDArray[np.float64], quats: NDArray[np.float64]
) -> None:
    with pytest.raises(SimulationError, match="a path with"):
        PosePath(t_ns, positions, quats)


def test_impossible_drives_are_refused() -> None:
    camera = DepthCamera(level_ground(), kinect_320(), KinectModel(), 0)
    with pytest.raises(DriverError, match=r"0\.1 s or more"):
        ScriptedDrive(camera, straight_path(0.05))
    with pytest.raises(DriverError, match=r"0\.2 to 3600 s"):
        IdealDrive(0, 0.1)
    with pytest.raises(DriverError, match="seed -1"):
        IdealDrive(-1, 1.0)
