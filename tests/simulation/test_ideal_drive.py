"""The simulated drive as a source of samples, and what it knows about the truth."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.errors import DriverError, EndOfSource
from drivers.samples import DepthFrame, PoseSample, Sample
from simulation.errors import SimulationError
from simulation.ideal_drive import IdealDrive
from simulation.motion import START_NS
from tests.fakes.recordings import bits


def _play(drive: IdealDrive) -> list[Sample]:
    drive.open()
    samples = [sample for _ in range(drive.frames) for sample in drive.read(0.0)]
    with pytest.raises(EndOfSource, match="end of the drive"):
        drive.read(0.0)
    return samples


def test_poses_come_at_50_hz_and_depth_at_10_hz_in_time_order() -> None:
    samples = _play(IdealDrive(1, 0.3))
    poses = [sample for sample in samples if isinstance(sample, PoseSample)]
    frames = [sample for sample in samples if isinstance(sample, DepthFrame)]
    assert [pose.t_ns - START_NS for pose in poses] == [20_000_000 * i for i in range(11)]
    assert [frame.t_ns - START_NS for frame in frames] == [0, 100_000_000, 200_000_000]
    assert [pose.sequence for pose in poses] == list(range(11))
    stamps = [sample.t_ns for sample in samples]
    assert stamps == sorted(stamps)
    assert not any(frame.depth_mm.flags.writeable for frame in frames)


def test_the_same_seed_gives_the_same_bits_again_and_after_reopening() -> None:
    drive = IdealDrive(2, 0.2)
    first = bits(tuple(_play(drive)))
    drive.close()
    drive.close()
    assert bits(tuple(_play(drive))) == first
    assert bits(tuple(_play(IdealDrive(2, 0.2)))) == first
    assert bits(tuple(_play(IdealDrive(3, 0.2)))) != first


def test_the_camera_rides_above_the_ground_and_looks_down() -> None:
    drive = IdealDrive(4, 5.0)
    for t_s in np.linspace(0.0, 5.0, 11):
        position, rotation = drive.body_pose(round(t_s * 1e9))
        ground = float(drive.terrain.height_m(position[:1], position[1:2])[0])
        assert position[2] - ground == pytest.approx(0.40)
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert -np.degrees(np.arcsin(rotation[2, 2])) == pytest.approx(25.0, abs=2.01)


def test_the_truth_is_the_terrain_where_at_least_four_rays_met() -> None:
    drive = IdealDrive(1, 0.2)
    _play(drive)
    truth = drive.truth(0.05, 0.5, 2.0)
    x, y = np.meshgrid(truth.x_m, truth.y_m)
    np.testing.assert_array_equal(truth.height_m, drive.terrain.height_m(x, y))
    cells = truth.x_m / 0.05 - 0.5
    np.testing.assert_allclose(cells, np.rint(cells), atol=1e-9)
    assert 0.2 < truth.visible.mean() < 1.0
    # The camera starts at (0, 0), looks along x, 57 degrees wide, from 0.4 m up.
    reach = np.hypot(x, y)[truth.visible]
    assert 0.3 < reach.min() < reach.max() < 2.4


def test_a_wider_range_shows_more() -> None:
    drive = IdealDrive(1, 0.2)
    _play(drive)
    near, far = drive.truth(0.05, 0.5, 1.5), drive.truth(0.05, 0.5, 4.0)
    assert near.visible.sum() < 0.5 * far.visible.sum()


def test_there_is_no_truth_before_anything_was_seen() -> None:
    drive = IdealDrive(1, 0.2)
    with pytest.raises(SimulationError, match="saw no ground within its range"):
        drive.truth(0.05, 0.5, 2.0)
    _play(drive)
    with pytest.raises(SimulationError, match="saw no ground within its range"):
        drive.truth(0.05, 9.0, 10.0)


def test_it_must_be_open_to_be_read() -> None:
    drive = IdealDrive(1, 0.2)
    with pytest.raises(DriverError, match="read before open"):
        drive.read(0.0)


@pytest.mark.parametrize("duration_s", [0.0, 0.1, 3601.0, float("nan")])
def test_impossible_durations_are_refused(duration_s: float) -> None:
    with pytest.raises(DriverError, match=r"expected 0\.2 to 3600 s"):
        IdealDrive(1, duration_s)


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(DriverError, match="seed -1; expected 0 or more"):
        IdealDrive(-1, 1.0)
