"""A recording mapped in one go, in two runs, or in as many as crashes make of it: one world."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from drivers.samples import DepthFrame, PoseSample
from mapping.cells.elevation_map import ElevationMap
from mapping.errors import MappingError
from mapping.mapper import Mapper
from mapping.motion.pose_errors import RELATIVE, PoseErrorModel
from mapping.motion.relative import RelativeMotion
from mapping.noise import KINECT_V1
from mapping.settings import MapSettings
from mapping.world.run_file import FRAMES_FILE, MOTIONS_FILE, RUN_FILE
from mapping.world.tile_store import TileStore
from mapping.world.world_grid import WorldGrid
from mapping.world.world_map import about_world, check_continues, read_world
from tests.mapping.scenes import floor_frame, looking, mount, pose_sample

FRAMES = 26
SETTINGS = MapSettings(resolution_m=0.05, grid="scrolling", window_m=4.0)
ALIGNED_SETTINGS = replace(SETTINGS, pose_source="mocap+alignment")


@dataclass(frozen=True)
class Way:
    """A drive with motions: told to the mapper, or found by it between aligned poses."""

    settings: MapSettings
    errors: PoseErrorModel | None

    def map(self, store: TileStore, numbers: Iterable[int]) -> Mapper:
        """Map these frames of the drive, which leaves the window and comes back."""
        mapper = Mapper(self.settings, KINECT_V1, WorldGrid(self.settings, store), self.errors)
        mapper.add(mount())
        for n in numbers:
            pose, frame, motion = step(n)
            if self.errors is not None:
                mapper.move(motion)
            mapper.add(pose)
            mapper.add(frame)
        mapper.finish()
        return mapper

    def create(self, path: Path) -> TileStore:
        return TileStore.create(path, about_world(self.settings, KINECT_V1))


WAYS = {
    "told": Way(SETTINGS, replace(RELATIVE, drift_per_m=0.5)),
    "aligned": Way(ALIGNED_SETTINGS, None),
}


def step(n: int) -> tuple[PoseSample, DepthFrame, RelativeMotion]:
    """Return pose, frame and motion number n, from 1; the rover rests in frames 9 to 12."""
    place = 9 if 9 <= n <= 12 else n
    random = np.random.default_rng(place)
    x_m = 0.4 * min(place, FRAMES - place)
    yaw, pitch, roll = random.standard_normal(3)
    rotation = looking(yaw, 35.0 + pitch, roll)
    frame = floor_frame(n * 100_000_000, 0.4 + 0.01 * random.standard_normal(), rotation)
    pose = pose_sample(frame.t_ns, (x_m, 0.1 * place % 0.3, 0.4), rotation)
    covariance = np.diag([1e-5, 2e-5, 1e-6, 1e-5]) * random.uniform(0.5, 1.5)
    motion = RelativeMotion(frame.t_ns, pose.position_m, 0.1 * n, covariance, 0.4)
    return pose, frame, motion


@pytest.fixture(scope="module", params=WAYS)
def drive(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Way, ElevationMap]:
    """Return a way, and the world that it makes in one go."""
    way: Way = WAYS[request.param]
    path = tmp_path_factory.mktemp("once") / "w"
    with way.create(path) as store:
        mapper = way.map(store, range(1, FRAMES))
    whole = read_world(path)
    live = mapper.read_map({})
    half = 0.5 * SETTINGS.resolution_m
    window_m = [live.x_m[0] - half, live.y_m[0] - half, live.x_m[-1] + half, live.y_m[-1] + half]
    assert read_world(path, window_m).sha256() == live.sha256()
    assert (whole.pose_m2 + whole.horizontal_xx_m2)[whole.known].max() > 1e-5
    return way, whole


@pytest.mark.parametrize("cut", [10, FRAMES - 1])
def test_two_runs_make_the_world_of_one_to_the_bit(
    drive: tuple[Way, ElevationMap], cut: int, tmp_path: Path
) -> None:
    way, once = drive
    with way.create(tmp_path / "w") as store:
        way.map(store, range(1, cut + 1))
    with TileStore.reopen(tmp_path / "w") as store:
        check_continues(store, way.settings)
        way.map(store, range(cut + 1, FRAMES))
    assert read_world(tmp_path / "w").sha256() == once.sha256()


def test_a_run_without_depth_leaves_the_world_as_it_was(tmp_path: Path) -> None:
    """It is refused; the same run once more must not count its motions twice."""
    way = WAYS["told"]
    with way.create(tmp_path / "w") as store:
        way.map(store, range(1, 4))
    before = (tmp_path / "w" / RUN_FILE).read_bytes()
    with TileStore.reopen(tmp_path / "w") as store:
        mapper = way.map(store, ())
        mapper.move(step(4)[2])
        mapper.finish()
        with pytest.raises(MappingError, match="no depth frame; nothing can be mapped"):
            mapper.elevation_map()
    assert (tmp_path / "w" / RUN_FILE).read_bytes() == before


class _Crash(BaseException):
    """Ends the program at a point of its work."""


@contextmanager
def _crash_after(steps: int) -> Iterator[None]:
    """Crash at the replacement of a file that comes after so many."""
    whole_step = Path.replace
    left = iter(range(steps))

    def replacement(self: Path, target: Path) -> Path:
        if next(left, None) is None:
            raise _Crash
        return whole_step(self, target)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Path, "replace", replacement)
        yield


def test_after_crashes_the_frames_that_are_not_in_it_make_the_same_world(
    drive: tuple[Way, ElevationMap], tmp_path: Path
) -> None:
    """Found poses: the whole recording again each time. Told motions: the rest, told once."""
    way, once = drive
    way.create(tmp_path / "w").close()
    crashes = 0
    for steps in (4, 9, 13, 22, 10_000):
        with TileStore.reopen(tmp_path / "w") as store:
            last = store.run.pose.t_ns // 100_000_000 if store.run.pose else 0
            with _crash_after(steps):
                try:
                    counts = way.map(store, range(last + 1 if way.errors else 1, FRAMES)).counts
                except _Crash:
                    crashes += 1
    assert crashes >= 3
    assert last > 3
    if way.errors is None:
        assert counts.frames_known >= last
        assert counts.frames_known + counts.frames + counts.misfits == FRAMES - 1
    assert read_world(tmp_path / "w").sha256() == once.sha256()


def test_a_world_is_not_continued_with_poses_of_another_source(tmp_path: Path) -> None:
    with (
        WAYS["told"].create(tmp_path / "w") as store,
        pytest.raises(MappingError, match=r"poses of mocap, .* give --pose-source mocap, or"),
    ):
        check_continues(store, ALIGNED_SETTINGS)


def test_a_world_that_does_not_know_its_frames_is_read_and_not_gone_on_with(
    tmp_path: Path,
) -> None:
    way = WAYS["told"]
    with way.create(tmp_path / "w") as store:
        way.map(store, range(1, 4))
    before = read_world(tmp_path / "w").sha256()
    run = json.loads((tmp_path / "w" / RUN_FILE).read_text())
    assert run.pop("frames") == 3
    (tmp_path / "w" / RUN_FILE).write_text(json.dumps(run))
    (tmp_path / "w" / FRAMES_FILE).unlink()
    with (
        TileStore.reopen(tmp_path / "w") as store,
        pytest.raises(MappingError, match=r"does not say which depth frames it holds: .* new worl"),
    ):
        check_continues(store, way.settings)
    assert read_world(tmp_path / "w").sha256() == before


@pytest.mark.parametrize(
    ("name", "keep"), [(RUN_FILE, 0.5), (MOTIONS_FILE, 0.9), (RUN_FILE, 0.0), (FRAMES_FILE, 0.5)]
)
def test_a_damaged_run_is_said(tmp_path: Path, name: str, keep: float) -> None:
    with WAYS["told"].create(tmp_path / "w") as store:
        WAYS["told"].map(store, range(1, 4))
    content = (tmp_path / "w" / name).read_bytes()
    (tmp_path / "w" / name).write_bytes(content[: int(keep * len(content))])
    for make in (TileStore.read_only, TileStore.reopen):
        with pytest.raises(MappingError, match=r"says of its run is damaged .* from a backup, or"):
            make(tmp_path / "w")
