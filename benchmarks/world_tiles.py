"""A world map of 200 m x 200 m written while driving: memory, time, and kills at random moments.

    python benchmarks/world_tiles.py [--edge-m M] [--kills N] [--json FILE]

Drive: a rover goes up and down the square in lanes 5 m apart; every 0.25 m it maps a frame of a
Kinect (320x240, 4 m) on cells of 5 cm through a window of 12 m, and the way from frame to frame is
a motion whose covariance grows that of the cells. Printed: resident memory after
each tenth of the drive, CPU time of a frame with and without the world, the longest pause, the
bytes on disk, and a window of 12 m read back. Yardstick: the same frames into a scrolling grid
that forgets.

Kills: a child goes to and fro over a strip and writes a mark, which counts up, into all layers of
the cells around it; it is killed by SIGKILL at a random moment, and the next child goes on. After
each kill the world must be as after one of the marks: every cell of the strip with the last mark up
to then in all its layers, and that mark not older than two saves.
"""

from __future__ import annotations

import sys
from pathlib import Path

# Python puts the script's own folder first, where `mapping.py` would hide the package.
sys.path[0] = str(Path(__file__).resolve().parents[1])

import argparse
import json
import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from acquisition.messages.frames import (
    DEPTH_OPTICAL_FRAME,
    MOCAP_BODY_FRAME,
    StaticTransform,
    StaticTransforms,
)
from drivers.samples import CameraIntrinsics, DepthFrame, PoseSample, frozen_array
from mapping.cells.grid import CellWindow, Grid, ScrollingGrid
from mapping.errors import MappingError
from mapping.geometry import RigidTransform, UncertainPose
from mapping.kernel_cache import compile_kernels
from mapping.mapper import Mapper
from mapping.motion.pose_errors import RELATIVE
from mapping.motion.read_out import standing
from mapping.motion.relative import RelativeMotion
from mapping.motion.run_state import RunState
from mapping.noise import KINECT_V1
from mapping.settings import MapSettings
from mapping.world.tile_store import TileStore
from mapping.world.tiles import shares
from mapping.world.world_grid import WorldGrid
from mapping.world.world_map import about_world, read_world

_SETTINGS = MapSettings(resolution_m=0.05, grid="scrolling", window_m=12.0)
_CAMERA = CameraIntrinsics(320, 240, 290.0, 290.0, 159.5, 119.5)
_STEP_M, _LANE_M = 0.25, 5.0
_MOTION_COVARIANCE = np.diag([1e-6, 1e-6, 1e-8, 1e-6])
_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_SMALL = MapSettings(resolution_m=0.05, grid="scrolling", window_m=1.2)
# The window saves itself each fourth of its edge: 6 cells, so at least every 6 marks of one cell.
_LATE_MARKS = 2 * 6


@dataclass(slots=True)
class Drive:
    """What a drive cost."""

    frames: int
    frame_ms: float
    longest_ms: float
    total_s: float
    rss_mb: list[float] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class World:
    """What the world weighs, and what a window of it costs."""

    tiles: int
    disk_mb: float
    seen_m2: float
    window_ms: float


@dataclass(frozen=True, slots=True)
class Kills:
    """What kills left behind."""

    kills: int
    as_after_one_frame: int
    within_a_save: int
    oldest_lag_marks: int


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--edge-m", type=float, default=200.0)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--victim", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.victim:
        _write_until_killed(options.victim)
    compile_kernels()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "world.zarr"
        forgetting = _drive(options.edge_m, None)
        with TileStore.create(path, about_world(_SETTINGS, KINECT_V1)) as store:
            keeping = _drive(options.edge_m, store)
        world = _weigh(path, options.edge_m)
        kills = _kill(Path(folder) / "victim.zarr", options.kills)
    _print(forgetting, keeping, world, kills)
    if options.json:
        rows = {
            "forgetting": asdict(forgetting),
            "keeping": asdict(keeping),
            "world": asdict(world),
            "kills": asdict(kills),
        }
        options.json.write_text(json.dumps(rows, indent=2) + "\n")


def _lanes(edge_m: float) -> Iterator[tuple[float, float, float]]:
    """Yield x, y and heading."""
    along = np.arange(0.0, edge_m, _STEP_M)
    for lane, y in enumerate(np.arange(0.0, edge_m, _LANE_M)):
        there = lane % 2 == 0
        for x in along if there else along[::-1]:
            yield float(x), float(y), 0.0 if there else np.pi


def _depth_mm() -> np.ndarray:
    """Return a floor 0.5 m below a camera that looks 25 degrees down."""
    v, u = np.mgrid[0:240, 0:320]
    ray = np.stack([(u - 159.5) / 290.0, (v - 119.5) / 290.0, np.ones_like(u, float)], axis=-1)
    down = (ray @ (_turn(0.0) @ _OPTICAL).T)[..., 2]
    z_m = np.where(down < -0.05, -0.5 / np.minimum(down, -0.05), 0.0)
    noise = 0.002 * np.random.default_rng(1).standard_normal(z_m.shape)
    return np.rint(1000.0 * np.where(z_m > 0.0, z_m + noise, 0.0)).astype(np.uint16)


def _turn(heading: float) -> np.ndarray:
    matrix: np.ndarray = Rotation.from_euler("ZY", [heading, np.radians(25.0)]).as_matrix()
    return matrix


def _drive(edge_m: float, store: TileStore | None) -> Drive:
    grid: Grid = WorldGrid(_SETTINGS, store) if store else ScrollingGrid(_SETTINGS)
    mapper = Mapper(_SETTINGS, KINECT_V1, grid, RELATIVE)
    quat = Rotation.from_matrix(_OPTICAL).as_quat(scalar_first=True)
    camera = StaticTransform(
        MOCAP_BODY_FRAME,
        DEPTH_OPTICAL_FRAME,
        frozen_array((0, 0, 0.5), (3,)),
        frozen_array(quat, (4,)),
    )
    mapper.add(StaticTransforms(0, (camera,)))
    image, covariance = _depth_mm(), frozen_array(1e-6 * np.eye(6), (6, 6))
    places = list(_lanes(edge_m))
    times: list[float] = []
    rss_mb: list[float] = []
    for n, (x, y, heading) in enumerate(places):
        rotation = Rotation.from_matrix(_turn(heading)).as_quat(scalar_first=True)
        pose = PoseSample(
            n * 100_000_000,
            frozen_array((x, y, 0), (3,)),
            frozen_array(rotation, (4,)),
            covariance,
            n,
        )
        motion = RelativeMotion(pose.t_ns, pose.position_m, heading, _MOTION_COVARIANCE, _STEP_M)
        start = time.process_time()
        mapper.move(motion)
        mapper.add(pose)
        mapper.add(DepthFrame(pose.t_ns, image, _CAMERA, n))
        times.append(time.process_time() - start)
        if (n + 1) % max(len(places) // 10, 1) == 0:
            rss_mb.append(_rss_mb())
    start = time.process_time()
    mapper.finish()
    times[-1] += time.process_time() - start
    return Drive(len(places), 1e3 * float(np.median(times)), 1e3 * max(times), sum(times), rss_mb)


def _rss_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def _weigh(path: Path, edge_m: float) -> World:
    with TileStore.read_only(path) as store:
        tiles = store.tiles()
        seen = sum(int(np.count_nonzero(store.read(tile).frames)) for tile in tiles)
    disk = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    middle = 0.5 * edge_m
    times = []
    for _ in range(5):
        start = time.process_time()
        read_world(path, (middle - 6.0, middle - 6.0, middle + 6.0, middle + 6.0))
        times.append(time.process_time() - start)
    area_m2 = seen * _SETTINGS.resolution_m**2
    return World(len(tiles), disk / 1e6, area_m2, 1e3 * float(np.median(times)))


def _write_until_killed(path: Path) -> None:
    """Go round over the same cells for ever, and write a mark, ever larger, into all layers."""
    if (path / "zarr.json").exists():
        store = TileStore.reopen(path)
    else:
        store = TileStore.create(path, about_world(_SMALL, KINECT_V1))
    mark = _mark(store)
    grid = WorldGrid(_SMALL, store)
    print("writing", flush=True)
    while True:
        mark += 1
        x = _place(mark)
        window = grid.prepare(CellWindow(x - 5, -5, 11, 11), (x + 0.5) * 0.05, 0.0)
        row, column = grid.position(window)
        edge = grid.layers.frames.shape[0]
        places = np.ix_((row + np.arange(11)) % edge, (column + np.arange(11)) % edge)
        for layer in grid.layers._asdict().values():
            layer[places] = mark % 250 + 1 if layer.dtype.itemsize == 1 else mark
        place = RigidTransform(np.eye(3), np.array([(x + 0.5) * 0.05, 0.0, 0.0]))
        pose = UncertainPose(mark, place, np.zeros((6, 6)))
        grid.keep(RunState(standing((x + 0.5) * 0.05), pose, None, 0.0))
        (path.parent / "mark").write_text(str(mark))


def _place(mark: int) -> int:
    """Return the column of cells that is marked."""
    return 13 * abs(mark % 40 - 20)


def _mark(store: TileStore) -> int:
    """Return the mark that a world is as after; 0 = none."""
    return store.run.pose.t_ns if store.run.pose else 0


def _check(store: TileStore) -> None:
    """Refuse a world that is not as after its mark.

    Raises:
        MappingError: a tile is damaged, or a cell has another mark in one of its layers.
    """
    last = _mark(store)
    expected = np.zeros((11, 13 * 20 + 11), np.uint32)
    for mark in range(max(last - 80, 0) + 1, last + 1):
        expected[:, _place(mark) : _place(mark) + 11] = mark
    strip = CellWindow(-5, -5, expected.shape[1], 11)
    marked = 0
    for tile, inside, outside in shares(strip):
        layers = store.read(tile)
        marks = expected[outside]
        marked += int(np.count_nonzero(layers.frames))
        for layer in layers._asdict().values():
            wanted = np.where(marks > 0, marks % 250 + 1, 0) if layer.itemsize == 1 else marks
            if not np.array_equal(layer[inside], wanted):
                raise MappingError(f"tile {tile} is not as after mark {last}")
    if marked != np.count_nonzero(expected):
        raise MappingError("there are marks beside the strip")


def _kill(path: Path, kills: int) -> Kills:
    """Let children write, kill each, look at what is left."""
    random = np.random.default_rng(5)
    whole = within_save = lag = 0
    for _ in range(kills):
        command = [sys.executable, str(Path(__file__)), "--victim", str(path)]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as victim:
            assert victim.stdout is not None
            victim.stdout.readline()
            time.sleep(float(random.uniform(0.0, 0.5)))
            os.kill(victim.pid, signal.SIGKILL)
        within_save += any(path.glob("staged.?/c"))
        mark_file = path.parent / "mark"
        written = int(mark_file.read_text() or 0) if mark_file.exists() else 0
        try:
            for opened in (TileStore.read_only, TileStore.reopen):
                with opened(path) as store:
                    _check(store)
                    newest = _mark(store)
        except MappingError as error:
            print(f"NOT AS AFTER ONE FRAME: {error}")
            continue
        whole += 1
        lag = max(lag, written - newest)
    return Kills(kills, whole, within_save, lag)


def _print(forgetting: Drive, keeping: Drive, world: World, kills: Kills) -> None:
    print(f"{'drive':>12} {'frames':>7} {'median ms':>10} {'longest ms':>11} {'CPU s':>7}  RSS MB")
    for name, row in (("forgetting", forgetting), ("into a world", keeping)):
        rss = " ".join(f"{mb:.0f}" for mb in row.rss_mb)
        print(
            f"{name:>12} {row.frames:>7} {row.frame_ms:>10.2f} {row.longest_ms:>11.1f} "
            f"{row.total_s:>7.1f}  {rss}"
        )
    growth = keeping.rss_mb[-1] - keeping.rss_mb[1]
    print(
        f"world: {world.tiles} tiles, {world.seen_m2:.0f} m2 seen, {world.disk_mb:.0f} MB on disk; "
        f"12 m window read in {world.window_ms:.0f} ms; memory grew by {growth:.1f} MB after the "
        "second tenth of the drive"
    )
    print(
        f"kills: {kills.as_after_one_frame} of {kills.kills} worlds as after one frame, "
        f"{kills.within_a_save} killed within a save, at most {kills.oldest_lag_marks} marks "
        f"behind (a save is due every {_LATE_MARKS // 2})"
    )


if __name__ == "__main__":
    main()
