"""A window over a world: nothing is lost by leaving, nor by a crash what was saved."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mapping.cells.cell_layers import CellLayers, copy_cells, empty_layers
from mapping.cells.grid import CellWindow, Grid, GrowingGrid, ScrollingGrid
from mapping.errors import MappingError
from mapping.geometry import RigidTransform, UncertainPose
from mapping.mapper import Mapper
from mapping.motion.read_out import standing
from mapping.motion.run_state import RunState
from mapping.noise import KINECT_V1
from mapping.settings import MapSettings
from mapping.world.tile_array import TileArray
from mapping.world.tile_store import TileStore
from mapping.world.world_grid import WorldGrid
from mapping.world.world_map import about_world, read_world
from tests.mapping.scenes import floor_frame, looking, mount, pose_sample
from tests.mapping.world.test_tile_store import same

CELL_M = 0.05
WINDOW_CELLS = 12
SMALL = MapSettings(grid="scrolling", resolution_m=CELL_M, window_m=WINDOW_CELLS * CELL_M)
ABOUT = about_world(SMALL, KINECT_V1)
_ROOT = Path(__file__).resolve().parents[3]

steps = st.tuples(st.integers(-9, 9), st.integers(-9, 9))
jumps = st.tuples(st.integers(-300, 300), st.integers(-300, 300))
walks = st.lists(steps | jumps, min_size=1, max_size=8)


def visit(grid: Grid, x: int, y: int, mark: int) -> CellWindow:
    """Stand in cell (x, y), see 7 x 5 cells beside it, and write a mark into all layers."""
    window = grid.prepare(CellWindow(x - 2, y + 1, 7, 5), (x + 0.5) * CELL_M, (y + 0.5) * CELL_M)
    row, column = grid.position(window)
    rows, columns = grid.layers.frames.shape
    places = np.ix_(
        (row + np.arange(window.cells_y)) % rows, (column + np.arange(window.cells_x)) % columns
    )
    for layer in grid.layers._asdict().values():
        layer[places] = mark
    grid.keep(run_after(mark))
    return window


def run_after(frame: int, x_m: float = 0.0) -> RunState:
    """Return the state of a run without motions after a frame at (x_m, 0)."""
    pose = UncertainPose(
        frame, RigidTransform(np.eye(3), np.array([x_m, 0.0, 0.0])), np.zeros((6, 6))
    )
    return RunState(standing(x_m), pose, None, 0.0)


def world_cells(store: TileStore) -> dict[tuple[int, int], int]:
    """Return the marks in a store by cell; all layers of a cell agree."""
    found = {}
    for tile in store.tiles():
        layers = store.read(tile)
        for layer in layers._asdict().values():
            np.testing.assert_array_equal(layer, layers.frames)
        for j, i in zip(*np.nonzero(layers.frames), strict=True):
            cell = tile[0] * 128 + int(i), tile[1] * 128 + int(j)
            found[cell] = int(layers.frames[j, i])
    return found


@given(walks, st.integers(-100_000, 100_000))
@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_walk_leaves_every_mark_in_the_world(
    tmp_path_factory: pytest.TempPathFactory, walk: list[tuple[int, int]], start: int
) -> None:
    expected: dict[tuple[int, int], int] = {}
    x, y = start, -start
    with TileStore.create(tmp_path_factory.mktemp("world") / "w", ABOUT) as store:
        grid = WorldGrid(SMALL, store)
        for mark, (dx, dy) in enumerate([(0, 0), *walk], 1):
            x, y = x + dx, y + dy
            window = visit(grid, x, y, mark)
            for j in range(window.cells_y):
                for i in range(window.cells_x):
                    expected[window.first_x + i, window.first_y + j] = mark
        grid.keep(run_after(99), at_once=True)
        assert world_cells(store) == expected
        _check_window(grid, expected)


def _check_window(grid: WorldGrid, expected: dict[tuple[int, int], int]) -> None:
    layers, extent = grid.unrolled(), grid.extent
    for j in range(extent.cells_y):
        for i in range(extent.cells_x):
            cell = extent.first_x + i, extent.first_y + j
            assert layers.frames[j, i] == expected.get(cell, 0)


def _there_and_back(grid: Grid) -> CellLayers:
    """Drive 3 m along x and back with noisy views of a floor; return the cells around the start."""
    random = np.random.default_rng(3)
    settings = MapSettings(resolution_m=CELL_M, grid="scrolling", window_m=9.0)
    mapper = Mapper(settings, KINECT_V1.with_range(0.4, 2.0), grid)
    mapper.add(mount())
    places_m = [0.25 * n for n in range(24)]
    for n, x_m in enumerate([*places_m, *reversed(places_m)]):
        rotation = looking(*(random.standard_normal(3) * 3.0 + (0.0, 35.0, 0.0)))
        frame = floor_frame(n * 100_000_000, 0.4 + 0.01 * random.standard_normal(), rotation)
        mapper.add(pose_sample(frame.t_ns, (x_m, 0.1 * n % 0.3, 0.4), rotation))
        mapper.add(frame)
    mapper.finish()
    assert mapper.counts.readings_outside == 0
    return _around_start(grid)


def _around_start(grid: Grid) -> CellLayers:
    extent, around = grid.extent, empty_layers(41, 40)
    rows = slice(-20 - extent.first_y, 21 - extent.first_y)
    columns = slice(-extent.first_x, 40 - extent.first_x)
    copy_cells(grid.unrolled(), (rows, columns), around, (slice(None), slice(None)))
    return around


def test_continuing_after_a_return_equals_never_having_left_to_the_bit(tmp_path: Path) -> None:
    window = MapSettings(resolution_m=CELL_M, grid="scrolling", window_m=5.0)
    never_left = _there_and_back(GrowingGrid(window))
    with TileStore.create(tmp_path / "w", about_world(window, KINECT_V1)) as store:
        assert same(_there_and_back(WorldGrid(window, store)), never_left)
    forgot = _there_and_back(ScrollingGrid(window))
    assert forgot.frames.sum() < never_left.frames.sum()


def test_a_second_session_goes_on_where_the_first_ended(tmp_path: Path) -> None:
    with TileStore.create(tmp_path / "w", ABOUT) as store:
        grid = WorldGrid(SMALL, store)
        visit(grid, 0, 0, 7)
        grid.keep(run_after(1), at_once=True)
    with TileStore.reopen(tmp_path / "w") as store:
        again = WorldGrid(SMALL, store)
        again.prepare(CellWindow(0, 0, 1, 1), 0.0, 0.0)
        assert (again.unrolled().frames == grid.unrolled().frames).all()
        assert again.unrolled().frames.any()


def test_memory_holds_no_more_than_the_tiles_around_the_window(tmp_path: Path) -> None:
    with TileStore.create(tmp_path / "w", ABOUT) as store:
        grid = WorldGrid(SMALL, store)
        most = 0
        for n in range(40):
            visit(grid, 60 * n, 0, n + 1)
            most = max(most, len(grid._world._tiles))
        assert most <= 16
        assert len(store.tiles()) >= 15


def test_tiles_that_did_not_change_are_not_written_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written: list[object] = []
    whole_write = TileArray.write

    def write(self: TileArray, tile: tuple[int, int], layers: CellLayers) -> None:
        written.append(tile)
        whole_write(self, tile, layers)

    monkeypatch.setattr(TileArray, "write", write)
    with TileStore.create(tmp_path / "w", ABOUT) as store:
        grid = WorldGrid(SMALL, store)
        visit(grid, 20, 20, 1)
        grid.keep(run_after(1), at_once=True)
        grid.keep(run_after(1), at_once=True)
        for x in (400, 20):
            grid.prepare(CellWindow(x, 20, 1, 1), x * CELL_M, 20 * CELL_M)
        grid.keep(run_after(1), at_once=True)
    assert written == [(0, 0)]


def test_a_cell_that_was_forgotten_stays_forgotten(tmp_path: Path) -> None:
    with TileStore.create(tmp_path / "w", ABOUT) as store:
        grid = WorldGrid(SMALL, store)
        visit(grid, 0, 0, 5)
        grid.keep(run_after(1), at_once=True)
        visit(grid, 0, 0, 0)
        for x in (300, 600, 0):
            grid.prepare(CellWindow(x, 0, 1, 1), x * CELL_M, 0.0)
        assert not grid.unrolled().frames.any()


class _Crash(BaseException):
    """Ends the program at a point of its work."""


def test_whichever_step_a_crash_comes_before_the_world_is_as_after_one_frame(
    tmp_path: Path,
) -> None:
    walk = [(0, 0), (125, 125), (0, 0)]
    expected: list[dict[tuple[int, int], int]] = [{}]
    for mark, (x, y) in enumerate(walk, 1):
        seen = {(i, j): mark for i in range(x - 2, x + 5) for j in range(y + 1, y + 6)}
        expected.append(expected[-1] | seen)
    total = _walk_until_crash(tmp_path / "whole", walk, 10_000)
    assert total >= 12
    after = []
    for crash in range(total):
        path = tmp_path / f"crash{crash}"
        assert _walk_until_crash(path, walk, crash) == crash
        with TileStore.read_only(path) as store:
            found = world_cells(store)
        with TileStore.reopen(path) as store:
            assert world_cells(store) == found
            assert not list(path.rglob("*.partial"))
            after.append(store.run.pose.t_ns if store.run.pose else 0)
            assert found == expected[after[-1]]
            visit(WorldGrid(SMALL, store), 0, 0, 99)
    assert sorted(set(after)) == [0, 2, 3]
    assert after == sorted(after)


def _walk_until_crash(path: Path, walk: list[tuple[int, int]], crash: int) -> int:
    """Walk; before that step leave half a file as a kill does, and end. Return the steps done."""
    steps = 0
    whole_step = Path.replace

    def replace(self: Path, target: Path) -> Path:
        nonlocal steps
        if steps == crash:
            content = self.read_bytes()
            self.with_name("killed.partial").write_bytes(content[: len(content) // 2])
            raise _Crash
        steps += 1
        return whole_step(self, target)

    with pytest.MonkeyPatch.context() as patch, TileStore.create(path, ABOUT) as store:
        patch.setattr(Path, "replace", replace)
        grid = WorldGrid(SMALL, store)
        with suppress(_Crash):
            for mark, (x, y) in enumerate(walk, 1):
                visit(grid, x, y, mark)
            grid.keep(run_after(mark), at_once=True)
    return steps


_VICTIM = """
import sys
from pathlib import Path
from mapping.world.tile_store import TileStore
from mapping.world.world_grid import WorldGrid
from tests.mapping.world.test_world_grid import ABOUT, SMALL, visit
with TileStore.create(Path(sys.argv[1]), ABOUT) as store:
    grid = WorldGrid(SMALL, store)
    for mark in range(1, 100_000):
        visit(grid, 60 * (mark % 7), 0, mark)
        if mark == 20:
            print("driving", flush=True)
"""


def test_a_killed_writer_leaves_a_whole_world(tmp_path: Path) -> None:
    path = tmp_path / "w"
    victim = subprocess.Popen(
        [sys.executable, "-c", _VICTIM, str(path)], cwd=_ROOT, stdout=subprocess.PIPE
    )
    with victim:
        assert victim.stdout is not None
        victim.stdout.readline()
        os.kill(victim.pid, signal.SIGKILL)
    with TileStore.reopen(path) as store:
        marks = world_cells(store)
        assert marks
        assert max(marks.values()) >= 10


def test_a_window_of_a_world_is_an_ordinary_map(tmp_path: Path) -> None:
    window = MapSettings(resolution_m=CELL_M, grid="scrolling", window_m=5.0)
    with TileStore.create(tmp_path / "w", about_world(window, KINECT_V1)) as store:
        _there_and_back(WorldGrid(window, store))
    whole = read_world(tmp_path / "w")
    assert whole.x_m[-1] - whole.x_m[0] > 6.0
    assert whole.attributes["setting_window_m"] == 5.0
    with pytest.raises(
        MappingError, match=r"nothing in the window; its tiles reach from -?\d.* m: "
    ):
        read_world(tmp_path / "w", (500.0, 500.0, 501.0, 501.0))
    part = read_world(tmp_path / "w", (1.0, -0.5, 2.0, 0.5))
    assert 0.9 < part.x_m[-1] - part.x_m[0] <= 1.0
    columns = np.searchsorted(whole.x_m, part.x_m - 1e-9)
    rows = np.searchsorted(whole.y_m, part.y_m - 1e-9)
    np.testing.assert_array_equal(part.elevation_m, whole.elevation_m[np.ix_(rows, columns)])


@pytest.mark.parametrize(
    ("window_m", "reason"),
    [
        ((1.0, 0.0, 0.0, 1.0), "expected x_min y_min x_max y_max in metres"),
        ((0.0, 0.0, float("nan"), 1.0), "expected x_min y_min x_max y_max in metres"),
        ((-1e5, -1e5, 1e5, 1e5), "the window needs .* MB, the limit is 4096 MB; give a smaller"),
        ((500.0, 500.0, 501.0, 501.0), "is empty; map something into it first"),
        (None, "is empty; map something into it first"),
    ],
)
def test_windows_that_cannot_be_given_are_refused(
    tmp_path: Path, window_m: tuple[float, ...] | None, reason: str
) -> None:
    TileStore.create(tmp_path / "w", ABOUT).close()
    with pytest.raises(MappingError, match=reason):
        read_world(tmp_path / "w", window_m)


def test_an_unplaced_window_saves_nothing(tmp_path: Path) -> None:
    with TileStore.create(tmp_path / "w", ABOUT) as store:
        WorldGrid(SMALL, store).keep(run_after(0), at_once=True)
        assert store.tiles() == []
