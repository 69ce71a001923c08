"""Ready-made worlds: what their devices report, where things sit, which requests are refused."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from acquisition.clocks.device_clock import DeviceClock, DeviceClockSettings
from acquisition.messages import frames
from acquisition.messages.frames import StaticTransform
from drivers.errors import DriverError, EndOfSource
from drivers.samples import DepthFrame, PoseSample, Sample, VibrationSample
from mapping.calibration_file import parse_noise
from mapping.mounts import MountTree
from simulation.devices.depth_camera import DepthCamera
from simulation.devices.kinect import KinectModel, kinect_320
from simulation.devices.kinect_noise import kinect_noise_file
from simulation.devices.sensor_mounts import sensor_mounts
from simulation.errors import SimulationError
from simulation.faults import BlindPatches, Unplug
from simulation.scenario_source import ScenarioSource
from simulation.scenarios import SCENARIOS, SHORTEST_S, make_scenario
from simulation.vehicle.routes import around_rocks, circle, there_and_back
from tests.simulation.grounds import sloping


def read_all(source: ScenarioSource) -> list[Sample]:
    samples: list[Sample] = []
    while True:
        try:
            samples += source.read(0.0)
        except EndOfSource:
            return samples


@pytest.fixture(scope="module")
def driven() -> tuple[ScenarioSource, list[Sample]]:
    """Return a short run of the main scenario and all that it gave."""
    source = ScenarioSource(make_scenario("simulation", 2, SHORTEST_S))
    source.open()
    return source, read_all(source)


def test_all_devices_report_in_the_order_of_their_stamps(
    driven: tuple[ScenarioSource, list[Sample]],
) -> None:
    source, samples = driven
    stamps = [sample.t_ns for sample in samples]
    assert stamps == sorted(stamps)
    kinds = {kind: sum(isinstance(s, kind) for s in samples) for kind in source.open().produces}
    assert {type(sample) for sample in samples} == set(kinds)
    assert kinds[DepthFrame] == 40
    assert kinds[PoseSample] == 401
    assert source.read(0.0)[0].t_ns == stamps[0]  # opened again, it begins again
    source.close()


def test_the_vibration_sensor_s_ticks_are_of_the_counter_that_is_announced(
    driven: tuple[ScenarioSource, list[Sample]],
) -> None:
    source, samples = driven
    counter = source.open().counter
    source.close()
    found = [s for s in samples if isinstance(s, VibrationSample) and s.device_ticks is not None]
    assert counter is not None
    clock = DeviceClock(DeviceClockSettings(counter.rate_hz, counter.wrap_ticks))
    late_s = [(s.t_ns - clock.translate(s.device_ticks or 0, s.t_ns)) * 1e-9 for s in found]
    assert len(found) > 300
    assert not clock.take_events()  # the counter runs at that rate
    assert 0.0 <= min(late_s) <= max(late_s) < 0.05


def test_a_camera_that_is_unplugged_leaves_a_gap_in_frames_and_numbers(
    driven: tuple[ScenarioSource, list[Sample]],
) -> None:
    source, samples = driven
    faults = (
        Unplug(device="depth", start_s=1.0, duration_s=2.75),
        BlindPatches(start_s=3.0, patches=2, size=0.5),
    )
    options = replace(source.scenario.options, faults=faults)
    faulty = ScenarioSource(replace(source.scenario, options=options))
    faulty._run = source._run  # the same drive
    faulty.open()
    frames, whole = (
        [s for s in part if isinstance(s, DepthFrame)] for part in (read_all(faulty), samples)
    )
    assert [frame.sequence for frame in frames] == [*range(10), 38, 39]
    for frame in frames[:10]:
        np.testing.assert_array_equal(frame.depth_mm, whole[frame.sequence].depth_mm)
    for frame in frames[10:]:
        assert frame.t_ns == whole[frame.sequence].t_ns
        lost = (frame.depth_mm == 0) & (whole[frame.sequence].depth_mm != 0)
        assert lost.sum() > 1000
        assert (frame.depth_mm == whole[frame.sequence].depth_mm)[~lost].all()


def test_true_poses_are_those_of_the_rover_at_every_frame(
    driven: tuple[ScenarioSource, list[Sample]],
) -> None:
    source, samples = driven
    poses = {s.t_ns: s for s in samples if isinstance(s, PoseSample)}
    for frame in (s for s in samples if isinstance(s, DepthFrame)):
        position, quat = source.motion.pose_at(np.array([frame.t_ns]))
        np.testing.assert_array_equal(poses[frame.t_ns].position_m, position[0])
        np.testing.assert_allclose(poses[frame.t_ns].quat_wxyz, quat[0], atol=1e-15)
        assert samples.index(poses[frame.t_ns]) < samples.index(frame)


def test_the_truth_is_the_ground_that_was_looked_at(
    driven: tuple[ScenarioSource, list[Sample]],
) -> None:
    source = ScenarioSource(driven[0].scenario)
    with pytest.raises(SimulationError, match="open it first"):
        _ = source.motion
    with pytest.raises(DriverError, match="before open"):
        source.read(0.0)
    source._run = driven[0]._run  # the same drive
    source.open()
    source.read(0.0)
    truth = source.truth()
    ground = source.scenario.ground.height_at(truth.x_m[np.newaxis, :], truth.y_m[:, np.newaxis])
    np.testing.assert_array_equal(truth.height_m, ground)
    assert truth.visible.sum() > 2000
    # It stands at the origin and sees the ground 0.5 m to 4.5 m ahead.
    assert 0.4 < truth.x_m[truth.visible.any(axis=0)].min() < 0.9
    assert 3.5 < truth.x_m[truth.visible.any(axis=0)].max() < 4.6
    source.close()


def test_motion_capture_replaces_the_true_poses() -> None:
    source = ScenarioSource(make_scenario("indoor", 1, SHORTEST_S))
    assert source.scenario.poses == "mocap"
    assert source.open().details["poses"] == "mocap"
    poses = [s for s in source.read(0.0) if isinstance(s, PoseSample)]
    assert poses[0].covariance[0, 0] == pytest.approx(1e-6)
    truth, _ = source.motion.pose_at(np.array([pose.t_ns for pose in poses]))
    errors = np.array([pose.position_m for pose in poses]) - truth
    assert 5e-4 < errors.std() < 2e-3
    source.close()


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenario_drives_from_a_level_start(name: str) -> None:
    scenario = make_scenario(name, 3, 10.0)
    radius = np.linspace(-0.3, 0.3, 7)
    assert np.ptp(scenario.ground.height_at(radius[np.newaxis, :], radius[:, np.newaxis])) < 1e-6
    other = make_scenario(name, 4, 10.0)
    assert not np.array_equal(scenario.ground.height_m, other.ground.height_m)
    again = make_scenario(name, 3, 10.0)
    np.testing.assert_array_equal(scenario.ground.height_m, again.ground.height_m)


def test_the_mounts_are_the_camera_s_and_have_the_recordings_names() -> None:
    scenario = make_scenario("smooth", 1, SHORTEST_S)
    mounts = sensor_mounts(scenario.options, scenario.mount)
    tree = MountTree()
    tree.add([StaticTransform(*mount) for mount in mounts])
    camera = tree.lookup(frames.MOCAP_BODY_FRAME, frames.DEPTH_OPTICAL_FRAME)
    np.testing.assert_allclose(camera.rotation, scenario.mount.rotation, atol=1e-12)
    np.testing.assert_allclose(camera.translation_m, scenario.mount.position_m)
    assert {mount.child_frame for mount in mounts} == {
        frames.BASE_FRAME,
        frames.DEPTH_OPTICAL_FRAME,
        frames.ACCELEROMETER_FRAME,
        frames.VIBRATION_FRAME,
        frames.GYRO_FRAME,
        frames.WHEELS_FRAME,
    }


@pytest.mark.parametrize(("height_m", "degrees"), [(1.0, 0.0), (2.5, 0.0), (2.0, 40.0)])
def test_the_noise_file_is_what_the_camera_does(height_m: float, degrees: float) -> None:
    model = KinectModel()
    noise = parse_noise(json.dumps(kinect_noise_file(model)), "the simulated Kinect")
    camera = DepthCamera(sloping(degrees, 12.0), kinect_320(), model, 1)
    view = camera.look(np.array([0.0, 0.0, height_m]), np.diag([1.0, -1.0, -1.0]))
    images = np.array([camera.frame(view, index, index).depth_mm for index in range(40)])
    usable = (images > 0).all(axis=0)
    errors = images[:, usable] * 1e-3 - view.z_m[usable]
    sigma = noise.axial_sigma_m(view.z_m, np.arccos(view.cos_incidence))[usable]
    assert np.sqrt(np.mean((errors / sigma) ** 2)) == pytest.approx(1.0, abs=0.05)


def test_the_way_leads_around_high_rocks_only() -> None:
    points, normals = circle(3.0, 0.4)
    blocked = points[[5, 20]]
    rocks = np.zeros((2, 6))
    rocks[:, :2], rocks[:, 2] = blocked, 0.3
    rocks[:, 3] = [0.15, 0.02]  # the second is low
    way = np.array(around_rocks(points, normals, rocks))
    finely = np.concatenate([np.linspace(a, b, 20) for a, b in pairwise(way)])
    away = np.linalg.norm(finely - blocked[0], axis=1)
    assert away.min() > 0.15 + 0.2
    np.testing.assert_allclose(way[20], points[20])
    np.testing.assert_allclose(way[-1], points[-1], atol=1e-9)
    np.testing.assert_allclose(points[-1], [0.0, 0.0], atol=1e-9)


def test_there_and_back_is_long_enough() -> None:
    assert there_and_back(7.0, 6.0) == [(7.0, 0.0), (0.0, 0.0)]
    assert len(there_and_back(7.0, 70.0)) * 7.0 >= 70.0


@pytest.mark.parametrize(
    ("name", "seed", "seconds", "poses", "words"),
    [
        ("mars", 1, 10.0, None, "simulation, smooth, rough, indoor, outdoor"),
        ("simulation", -1, 10.0, None, "0 to 4294967295"),
        ("simulation", 2**32, 10.0, None, "0 to 4294967295"),
        ("simulation", 1, 3.0, None, "4 to 3600 s"),
        ("simulation", 1, float("nan"), None, "4 to 3600 s"),
        ("simulation", 1, 1e9, None, "4 to 3600 s"),
        ("simulation", 1, 10.0, "guessed", "true, mocap"),
    ],
)
def test_impossible_scenarios_are_refused(
    name: str, seed: int, seconds: float, poses: Any, words: str
) -> None:
    with pytest.raises(SimulationError, match=words) as refused:
        make_scenario(name, seed, seconds, poses)
    assert "\n" not in str(refused.value)
