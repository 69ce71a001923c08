"""Speed of the clean-up of a map on one core: visibility, shadows, the rover, overhangs.

    python benchmarks/visibility.py [--frames N] [--json FILE]

A camera of 640x480 looks over a box on a floor, 25 degrees down from 0.6 m, at a map of 300x300
cells that were all seen before; the map is a ghost of itself, so that every cell in view is looked
through. Time is CPU time of the thread, median over the frames. The yardstick is walking along
every ray of the image through the cells.
"""

from __future__ import annotations

import sys
from pathlib import Path

# Python puts the script's own folder first, where `mapping.py` would hide the package.
sys.path[0] = str(Path(__file__).resolve().parents[1])

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from drivers.samples import CameraIntrinsics
from mapping.cells.grid import ScrollingGrid
from mapping.change.hidden import mark_hidden
from mapping.change.overhang import drop_overhangs
from mapping.change.own_body import drop_own_body
from mapping.change.visibility import clear_seen_through, sight_of
from mapping.geometry import RigidTransform, UncertainPose
from mapping.kernel_cache import compile_kernels
from mapping.measurement import FrameReducer, View
from mapping.noise import KINECT_V1
from mapping.settings import MapSettings

Float64Array = NDArray[np.float64]
_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_CAMERA = CameraIntrinsics(640, 480, 580.0, 580.0, 319.5, 239.5)
_BOXES_M = ((-0.5, -0.4, -0.6, 0.3, 0.4, 0.1), (0.2, -0.1, -0.4, 0.6, 0.1, 0.0))
_BAR_MS = 10.0


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table."""

    step: str
    cell_m: float
    ms: float
    cells_looked_through: int
    readings_dropped: int


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=100, help="frames for each row")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    compile_kernels()
    rows = [row for cell_m in (0.02, 0.04) for row in _measure(cell_m, options.frames)]
    print(f"{'step':>22} {'cell':>6} {'ms':>7} {'cells seen through':>19} {'dropped':>8}")
    for r in rows:
        print(
            f"{r.step:>22} {r.cell_m:>5.2f}m {r.ms:>7.2f} {r.cells_looked_through:>19} "
            f"{r.readings_dropped:>8}"
        )
    slowest = max(
        sum(r.ms for r in rows if r.cell_m == cell_m and r.step in ("visibility", "hidden cells"))
        for cell_m in (0.02, 0.04)
    )
    print(f"visibility and hidden cells, 300x300: {slowest:.2f} ms, bar {_BAR_MS:g} ms")
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=2) + "\n")


def _view() -> View:
    turn = Rotation.from_euler("Y", np.radians(25.0)).as_matrix() @ _OPTICAL
    pose = RigidTransform(turn, np.array([0.0, 0.0, 0.6]))
    return View(UncertainPose(0, pose, np.diag([1e-6] * 6)), pose)


def _image_mm() -> NDArray[np.uint16]:
    """Return a floor 0.6 m below with a wall in 3.5 m, and a box in 1.2 m with its shadow."""
    v, u = np.mgrid[0:480, 0:640]
    ray = np.stack([(u - 319.5) / 580.0, (v - 239.5) / 580.0, np.ones_like(u, float)], axis=-1)
    direction = ray @ _view().T_terrain_sensor.rotation.T
    down = np.minimum(direction[..., 2], -1e-6)
    z_m = np.minimum(-0.6 / down, 3.5 / np.maximum(direction[..., 0], 1e-6))
    z_m[200:320, 220:420] = 1.2
    return np.rint(1000.0 * np.minimum(z_m, 8.0)).astype(np.uint16)


def _measure(cell_m: float, frames: int) -> list[Row]:
    """Return a row for each step at that size of cells."""
    settings = MapSettings(
        grid="scrolling", resolution_m=cell_m, window_m=300 * cell_m, overhang_clearance_m=0.3
    )
    reducer, view, image = FrameReducer(_CAMERA, KINECT_V1, settings), _view(), _image_mm()
    grid = ScrollingGrid(settings)
    window = grid.prepare(reducer.footprint(view), 0.0, 0.0)
    constants = reducer.frame_constants(view, window, grid.position(window))
    sight = sight_of(_CAMERA, KINECT_V1, view, 255)
    layers = grid.layers
    sums = np.zeros((window.cells_x * window.cells_y, 4))

    def reset() -> None:
        """A ghost 0.25 m above the floor, of which this frame has no readings."""
        layers.elevation_m[:] = 0.25
        layers.variance_m2[:] = 1e-6
        layers.frames[:] = 9
        layers.pixels[:] = 99
        layers.seen_through[:] = 0
        reducer.load(image)

    def floor() -> None:
        """Put all cells on the floor, 0.2 m below the origin."""
        reset()
        layers.elevation_m[:] = -0.2

    dropped = 0

    def body() -> None:
        nonlocal dropped
        dropped = drop_own_body(reducer.readings, _BOXES_M, view.T_terrain_sensor)

    def overhang() -> None:
        nonlocal dropped
        dropped = drop_overhangs(reducer.readings, view, constants, layers, settings)

    def visibility() -> None:
        clear_seen_through(image, sums, constants, sight, layers)

    def hidden() -> None:
        mark_hidden(reducer.readings, view, constants, sight, layers.hidden)

    rows = []
    for name, work, before in (
        ("visibility", visibility, reset),
        ("hidden cells", hidden, reset),
        ("own body, 2 boxes", body, reset),
        ("overhangs", overhang, floor),
        ("yardstick: every ray", lambda: _walk_all(image, view, layers.elevation_m, cell_m), reset),
    ):
        dropped = 0
        ms = 1e3 * _median_s(work, before, frames if name[0] != "y" else 5)
        seen = int(np.count_nonzero(layers.seen_through)) if name == "visibility" else 0
        rows.append(Row(name, cell_m, ms, seen, dropped))
    return rows


def _median_s(work: Callable[[], None], before: Callable[[], None], repeats: int) -> float:
    times = []
    for _ in range(repeats + 1):
        before()
        start = time.thread_time()
        work()
        times.append(time.thread_time() - start)
    return float(np.median(times[1:]))


def _walk_all(
    image: NDArray[np.uint16], view: View, elevation_m: Float64Array, cell_m: float
) -> None:
    pose = view.T_terrain_sensor
    lowest = np.full(elevation_m.shape, np.inf)
    _walk(image, np.ascontiguousarray(pose.rotation), pose.translation_m, cell_m, lowest)


@njit(cache=True)
def _walk(
    image: NDArray[np.uint16],
    c: Float64Array,
    origin_m: Float64Array,
    cell_m: float,
    lowest_m: Float64Array,
) -> None:
    """Keep the lowest ray over every cell, in steps of half a cell along each ray."""
    rows, columns = lowest_m.shape
    for v in range(image.shape[0]):
        for u in range(image.shape[1]):
            x, y = (u - 319.5) / 580.0, (v - 239.5) / 580.0
            dx = c[0, 0] * x + c[0, 1] * y + c[0, 2]
            dy = c[1, 0] * x + c[1, 1] * y + c[1, 2]
            dz = c[2, 0] * x + c[2, 1] * y + c[2, 2]
            step = 0.5 * cell_m / max(np.sqrt(dx * dx + dy * dy), 1e-6)
            s = 0.4
            while s < image[v, u] * 1e-3 and s < 4.0:
                i = int(np.floor((origin_m[0] + s * dx) / cell_m)) + columns // 2
                j = int(np.floor((origin_m[1] + s * dy) / cell_m)) + rows // 2
                if 0 <= i < columns and 0 <= j < rows:
                    lowest_m[j, i] = min(lowest_m[j, i], origin_m[2] + s * dz)
                s += step


if __name__ == "__main__":
    main()
