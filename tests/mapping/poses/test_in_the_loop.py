"""A short simulated drive mapped with the rover's own poses."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

from acquisition.messages.codec import typestore
from acquisition.messages.frames import BASE_FRAME, StaticTransform, StaticTransforms
from drivers.errors import EndOfSource
from drivers.samples import (
    AccelerationSample,
    DepthFrame,
    PoseSample,
    Sample,
    VibrationSample,
    WheelTwistSample,
    YawRateSample,
)
from mapping.alignment.fusion import pose_difference
from mapping.calibration_file import parse_noise
from mapping.errors import MappingError
from mapping.geometry import RigidTransform, UncertainPose
from mapping.judging.trajectory import read_path
from mapping.mapper import Mapper
from mapping.output.odometry_file import write_trajectory
from mapping.poses.settings import PoseSourceName, TiltSource
from mapping.settings import MapSettings
from mapping.world.tile_store import TileStore
from mapping.world.world_grid import WorldGrid
from mapping.world.world_map import about_world, read_world
from simulation.devices.kinect_noise import kinect_noise_file
from simulation.devices.sensor_mounts import sensor_mounts
from simulation.motion import Motion
from simulation.scenario_source import ScenarioSource
from simulation.scenarios import make_scenario
from tests.mapping.world.conftest import zarr_stops  # noqa: F401 - a fixture, of all tests here

MOTION_SENSORS = (AccelerationSample, VibrationSample, YawRateSample, WheelTwistSample)


@dataclass
class Drive:
    """What the devices gave in 4.5 s, the last 1.5 of them driving."""

    samples: list[Sample]
    mounts: StaticTransforms
    noise: str
    motion: Motion

    def mapper(
        self,
        poses: PoseSourceName,
        samples: Sequence[Sample] | None = None,
        tilt: TiltSource = "levelled",
    ) -> tuple[Mapper, list[UncertainPose]]:
        return self.map(MapSettings(pose_source=poses, tilt_source=tilt), samples)

    def map(
        self,
        settings: MapSettings,
        samples: Sequence[Sample] | None = None,
        store: TileStore | None = None,
    ) -> tuple[Mapper, list[UncertainPose]]:
        found: list[UncertainPose] = []
        noise = parse_noise(self.noise, "test")
        grid = WorldGrid(settings, store) if store else None
        mapper = Mapper(settings, noise, grid, on_pose=found.append)
        mapper.add(self.mounts)
        for sample in self.samples if samples is None else samples:
            mapper.add(sample)
        mapper.finish()
        return mapper, found

    def without(self, *kinds: type) -> list[Sample]:
        return [sample for sample in self.samples if not isinstance(sample, kinds)]

    def true_pose(self, t_ns: int) -> RigidTransform:
        position, quat = self.motion.pose_at(np.array([t_ns]))
        return RigidTransform(
            Rotation.from_quat(quat[0], scalar_first=True).as_matrix(), position[0]
        )


@pytest.fixture(scope="module")
def drive() -> Drive:
    scenario = make_scenario("rough", 1, 4.5)
    source = ScenarioSource(scenario)
    source.open()
    samples: list[Sample] = []
    with suppress(EndOfSource):
        while True:
            samples += source.read(0.0)
    source.close()
    mounts = sensor_mounts(scenario.options, scenario.mount)
    transforms = tuple(StaticTransform(*mount) for mount in mounts)
    noise = json.dumps(kinect_noise_file(scenario.camera.model))
    start = StaticTransforms(source.motion.start_ns, transforms)
    return Drive(samples, start, noise, source.motion)


def _drift(drive: Drive, poses: Sequence[UncertainPose]) -> tuple[float, float]:
    """Return millimetres and degrees by which the motion from the first pose to the last is off."""
    first, last = (drive.true_pose(poses[i].t_ns) for i in (0, -1))
    found = first @ poses[0].transform.inverse() @ poses[-1].transform
    difference = pose_difference(found, last)
    return (
        1e3 * float(np.linalg.norm(difference[:3])),
        float(np.degrees(np.linalg.norm(difference[3:]))),
    )


@pytest.mark.parametrize("wheels", [True, False])
def test_alignment_keeps_the_rovers_own_poses(drive: Drive, wheels: bool) -> None:
    samples = drive.samples if wheels else drive.without(WheelTwistSample)
    mapper, poses = drive.mapper("ego-motion+alignment", samples)
    counts = mapper.counts
    assert counts.aligned + counts.unaligned == counts.frames == len(poses) >= 43
    assert (counts.unaligned, counts.misfits, counts.slid) == (1, 0, 0)
    drift_mm, drift_deg = _drift(drive, poses)
    assert drift_mm < 6.0
    assert drift_deg < 0.25
    map_ = mapper.elevation_map()
    assert mapper.counts.motions > 3
    assert (map_.pose_m2[map_.known] >= 0.001**2).all()


def test_a_world_is_continued_where_the_rover_stands_in_it(drive: Drive, tmp_path: Path) -> None:
    """The second run knows nothing of the way to there but what the world says."""
    settings = MapSettings(pose_source="ego-motion+alignment", grid="scrolling")
    first_ns, cut_ns = (drive.samples[0].t_ns + round(s * 1e9) for s in (3.4, 4.0))
    late = [s for s in drive.samples if not isinstance(s, DepthFrame) or s.t_ns > first_ns]
    about = about_world(settings, parse_noise(drive.noise, "test"))
    poses: list[UncertainPose] = []
    told: list[int] = []
    TileStore.create(tmp_path / "w", about).close()
    for samples in ([s for s in late if s.t_ns <= cut_ns], [s for s in late if s.t_ns > cut_ns]):
        with TileStore.reopen(tmp_path / "w") as store:
            mapper, found = drive.map(settings, samples, store)
            told.append(store.run.rover.motions.now)
        poses += found
        assert read_world(tmp_path / "w").sha256() == mapper.elevation_map().sha256()
    assert 0 < told[0] < told[1]
    assert mapper.counts.aligned == mapper.counts.frames == len(found) > 2
    drift_mm, drift_deg = _drift(drive, poses)
    assert drift_mm < 6.0
    assert drift_deg < 0.25


def test_late_samples_within_the_window_change_no_bit(drive: Drive) -> None:
    """Wheels and gyro arrive a tenth of a second later than they did."""
    late = (WheelTwistSample, YawRateSample)

    def arrival_ns(sample: Sample) -> int:
        return sample.t_ns + (100_000_000 if isinstance(sample, late) else 0)

    mixed = sorted(drive.samples, key=arrival_ns)
    sums = {
        drive.mapper("ego-motion+alignment", samples)[0].elevation_map().sha256()
        for samples in (drive.samples, mixed)
    }
    assert len(sums) == 1


def test_exact_poses_are_left_alone_by_alignment(drive: Drive) -> None:
    mapper, poses = drive.mapper("mocap+alignment", drive.without(*MOTION_SENSORS))
    assert mapper.counts.aligned > 40
    for pose in poses[::5]:
        difference = pose_difference(pose.transform, drive.true_pose(pose.t_ns))
        assert np.abs(difference).max() < 1e-9


@pytest.mark.parametrize(
    ("missing", "poses", "message"),
    [
        ((AccelerationSample,), "ego-motion", "tilt_source is levelled and the stream holds no"),
        ((AccelerationSample,), "ego-motion+alignment", "tilt_source is levelled"),
        ((WheelTwistSample, VibrationSample), "ego-motion", "nothing tells how far"),
        ((WheelTwistSample, YawRateSample), "ego-motion", "nothing tells the heading"),
        (MOTION_SENSORS, "ego-motion+alignment", "ego-motion has nothing to go by"),
    ],
)
def test_what_cannot_be_observed_is_refused(
    drive: Drive, missing: tuple[type, ...], poses: PoseSourceName, message: str
) -> None:
    with pytest.raises(MappingError, match=message):
        drive.mapper(poses, drive.without(*missing)[:3000])[0].elevation_map()


def test_level_ground_needs_no_acceleration(drive: Drive) -> None:
    samples = drive.without(AccelerationSample)[:1500]
    mapper, _ = drive.mapper("ego-motion+alignment", samples, "level")
    assert mapper.counts.frames > 5


def test_a_trajectory_comes_back(drive: Drive, tmp_path: Path) -> None:
    frames = [s for s in drive.samples if isinstance(s, DepthFrame | PoseSample)][:200]
    _, poses = drive.mapper("mocap", frames)
    for name in ("way.nc", "way.txt"):
        write_trajectory(tmp_path / name, poses, BASE_FRAME)
        found = read_path(tmp_path / name)
        assert found.t_ns.tolist() == [pose.t_ns for pose in poses]
        np.testing.assert_allclose(
            found.position_m[-1], poses[-1].transform.translation_m, atol=1e-9
        )


def test_a_trajectory_is_a_recording_of_odometry(drive: Drive, tmp_path: Path) -> None:
    _, poses = drive.mapper("mocap", drive.samples[:400])
    path = tmp_path / "way.mcap"
    write_trajectory(path, poses, BASE_FRAME)
    with path.open("rb") as file:
        messages = [(c.topic, m) for _, c, m in make_reader(file).iter_messages()]
    assert [topic for topic, _ in messages] == ["/odom", "/tf"] * len(poses)
    last: Any = typestore().deserialize_cdr(messages[-2][1].data, "nav_msgs/msg/Odometry")
    assert (last.header.frame_id, last.child_frame_id) == ("world", "base_link")
    assert last.pose.pose.position.x == poses[-1].transform.translation_m[0]
    assert messages[-2][1].log_time == poses[-1].t_ns
    with pytest.raises(MappingError, match="no pose was found"):
        write_trajectory(path, [], BASE_FRAME)
