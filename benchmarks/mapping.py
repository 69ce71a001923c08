"""Speed of the mapping steps on one core, beside yardsticks measured in the same run.

    python benchmarks/mapping.py [--frames N] [--json FILE]

The scene is analytic terrain seen from 0.6 m height, 25 degrees down, while the camera turns; the
map is a window of 6 m around the rover, and every frame comes with a motion whose covariance grows
that of the cells. Noise with incidence angle, transform, sums per cell, gate, update and motion are
all in. Time is CPU time of the thread, median over the frames. Yardsticks: a plain numpy version
of the measurement alone (float64, bincount), and the bytes that a frame must move at the speed at
which this machine copies memory.
"""

from __future__ import annotations

import sys
from pathlib import Path

# Python puts the script's own folder first, where this very file would hide the package `mapping`.
sys.path[0] = str(Path(__file__).resolve().parents[1])

import argparse
import json
import resource
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.numpy_measurement import numpy_frame
from drivers.samples import CameraIntrinsics
from mapping.cells.cell_layers import BYTES_PER_CELL, empty_layers
from mapping.cells.elevation_map import ElevationMap, read_out
from mapping.cells.grid import CellWindow, make_grid
from mapping.cells.update_constants import fusion_constants
from mapping.cells.update_kernels import fuse
from mapping.geometry import RigidTransform, UncertainPose
from mapping.ground.fusion import fuse_map
from mapping.kernel_cache import compile_kernels
from mapping.measurement import FrameReducer, View
from mapping.motion.ledger import MotionLedger
from mapping.motion.pose_errors import RELATIVE
from mapping.motion.read_out import Rover, place_errors
from mapping.motion.relative import RelativeMotion
from mapping.noise import NGUYEN_2012
from mapping.settings import MapSettings
from simulation.devices.ideal_camera import noisy_depth_mm, trace
from simulation.terrain.analytic import crater_field

Float64Array = NDArray[np.float64]
_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_VIEWS = 8
_CELLS = 300
# Sigma of the cells' places along both axes, and what a fused map of them may take at most.
_PLACES = {
    **{f"{100 * m:g} cm": (m, m) for m in (0.01, 0.02, 0.03, 0.05, 0.065, 0.1)},
    "5 x 1 cm": (0.05, 0.01),
}
_FUSED_BAR_MS = 15.0


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table; times in ms per frame, ns per touched cell or point."""

    image: str
    cell_m: float
    window_m: float
    copies: int
    valid_points: int
    touched_cells: int
    frame_ms: float
    mpoint_s: float
    load_ns_point: float
    reduce_ns_point: float
    update_ns_cell: float
    other_ms: float
    layers_mb: float
    moved_mb: float
    roofline_share: float
    times_numpy: float


@dataclass(frozen=True, slots=True)
class WholeMap:
    """Steps over a whole map of 300 x 300 cells, in ms, and million cells a second."""

    step: str
    ms: float
    mcell_s: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=200, help="frames for each row")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    compile_kernels()
    copy_gb_s = _copy_gb_s()
    cases = [
        *((width, cell_m, 6.0) for width in (160, 320, 640) for cell_m in (0.02, 0.05)),
        (640, 0.02, 3.0),
        (640, 0.02, 9.0),
    ]
    rows = [measure(*case, options.frames, copy_gb_s) for case in cases]
    with ProcessPoolExecutor(2) as pool:
        again = [pool.submit(measure, 640, 0.02, 6.0, options.frames, copy_gb_s) for _ in "ab"]
        both = [task.result() for task in again]
    rows.append(replace(both[0], copies=2, mpoint_s=sum(row.mpoint_s for row in both)))
    whole = whole_map()
    _print(rows, whole, copy_gb_s)
    if options.json:
        content = {
            "copy_gb_s": copy_gb_s,
            "frames": [asdict(row) for row in rows],
            "whole_map": [asdict(step) for step in whole],
        }
        options.json.write_text(json.dumps(content, indent=2) + "\n")


def _copy_gb_s() -> float:
    """Return how many bytes a second are read and written together when memory is copied."""
    source, target = np.ones(2**25), np.empty(2**25)
    seconds = _median_s(lambda _: np.copyto(target, source), 5)
    return 2.0 * source.nbytes / seconds / 1e9


def _camera(width: int) -> CameraIntrinsics:
    height = width * 3 // 4
    focal = 580.0 * width / 640
    return CameraIntrinsics(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


def _view(index: int) -> View:
    """Return a view: turning, at constant height over the mean ground."""
    turn = (
        Rotation.from_euler("ZY", [0.35 * (index % _VIEWS), np.radians(25.0)]).as_matrix()
        @ _OPTICAL
    )
    pose = RigidTransform(turn, np.array([2.0, 0.0, 0.6]))
    covariance = np.diag([1e-6] * 3 + [1e-6] * 3)
    return View(UncertainPose(index * 33_000_000, pose, covariance), pose)


def _images(camera: CameraIntrinsics) -> list[NDArray[np.uint16]]:
    terrain = crater_field(1, 6.0, 4.0)
    images = []
    for index in range(_VIEWS):
        pose = _view(index).T_terrain_sensor
        z_m, angle = trace(terrain, camera, pose.translation_m, pose.rotation, 4.5)
        images.append(noisy_depth_mm(z_m, angle, np.random.default_rng(index)))
    return images


class _Clock:
    """Adds up the thread's CPU time between laps, per name."""

    def __init__(self) -> None:
        self.laps: dict[str, float] = {}
        self._last = time.thread_time()

    def lap(self, name: str) -> None:
        now = time.thread_time()
        self.laps[name] = self.laps.get(name, 0.0) + now - self._last
        self._last = now


def measure(width: int, cell_m: float, window_m: float, frames: int, copy_gb_s: float) -> Row:
    """Return the times of mapping `frames` frames of that size into cells of that size."""
    camera = _camera(width)
    settings = MapSettings(resolution_m=cell_m, grid="scrolling", window_m=window_m)
    reducer = FrameReducer(camera, NGUYEN_2012, settings)
    grid = make_grid(settings)
    fusion = fusion_constants(settings)
    ledger = MotionLedger(with_covariance=True)
    images = _images(camera)
    laps: list[dict[str, float]] = []
    numbers: list[tuple[int, int, int]] = []
    for index in range(frames + _VIEWS):
        view, motion = _view(index), _motion(index)
        clock = _Clock()
        points = reducer.load(images[index % _VIEWS])
        clock.lap("load")
        ledger.add(motion)
        window = grid.prepare(reducer.footprint(view), 2.0, 0.0)
        clock.lap("other")
        sums, _ = reducer.reduce(view, window)
        clock.lap("reduce")
        constants = reducer.frame_constants(view, window, grid.position(window))
        clock.lap("other")
        counts = fuse(sums, constants, fusion, grid.layers, ledger.motions)
        clock.lap("update")
        laps.append(clock.laps)
        numbers.append((points, counts.cells, window.cells_x * window.cells_y))
    numpy_s = _median_s(lambda i: numpy_frame(images[i % _VIEWS], camera, cell_m, _view(i)), 5)
    layers_mb = sum(layer.nbytes for layer in grid.layers) / 1e6
    return _row(
        (width, cell_m, window_m),
        laps[_VIEWS:],
        np.array(numbers[_VIEWS:]),
        (copy_gb_s, numpy_s, layers_mb),
    )


def _motion(index: int) -> RelativeMotion:
    covariance = np.diag([1e-8, 1e-8, 1e-8, 1e-8])
    return RelativeMotion(index, np.array([2.0, 0.0, 0.6]), 0.35 * index, covariance, 0.001)


def _row(
    case: tuple[int, float, float],
    laps: list[dict[str, float]],
    numbers: NDArray[np.int64],
    yardsticks: tuple[float, float, float],
) -> Row:
    totals = np.array([sum(lap.values()) for lap in laps])
    points, cells, window = numbers.T
    seconds = {name: np.array([lap[name] for lap in laps]) for name in laps[0]}
    width, cell_m, window_m = case
    copy_gb_s, numpy_s, layers_mb = yardsticks
    pixels = width * width * 3 // 4
    # Depth in, metres out and in again; sums looked at, and of touched cells added to, read and
    # cleared; layers of touched cells read and written.
    moved = 10 * pixels + 32 * window + (4 * 32 + 2 * BYTES_PER_CELL) * cells
    return Row(
        image=f"{width}x{width * 3 // 4}",
        cell_m=cell_m,
        window_m=window_m,
        copies=1,
        valid_points=int(np.median(points)),
        touched_cells=int(np.median(cells)),
        frame_ms=1e3 * float(np.median(totals)),
        mpoint_s=float(np.median(points / totals)) / 1e6,
        load_ns_point=1e9 * float(np.median(seconds["load"] / points)),
        reduce_ns_point=1e9 * float(np.median(seconds["reduce"] / points)),
        update_ns_cell=1e9 * float(np.median(seconds["update"] / cells)),
        other_ms=1e3 * float(np.median(seconds["other"])),
        layers_mb=layers_mb,
        moved_mb=float(np.median(moved)) / 1e6,
        roofline_share=float(np.median(moved / totals)) / (1e9 * copy_gb_s),
        times_numpy=numpy_s / float(np.median(totals)),
    )


def whole_map() -> list[WholeMap]:
    """Return the times of the steps that look at every cell of a map, motions included."""
    random = np.random.default_rng(1)
    layers = empty_layers(_CELLS, _CELLS)
    layers.motion[:] = random.integers(0, 300, layers.motion.shape)
    ledger = MotionLedger(with_covariance=True)
    for index in range(300):
        ledger.add(_motion(index))
    centres_m: Float64Array = (np.arange(_CELLS, dtype=np.float64) - 149.5) * 0.02
    rover = Rover(0.0, 0.0, ledger.motions, RELATIVE)
    layers.elevation_m[:] = 0.1 * np.sin(3.0 * centres_m) * np.cos(centres_m[:, np.newaxis])
    layers.variance_m2[:] = 1e-6
    layers.frames[:] = layers.pixels[:] = 9
    grid = make_grid(MapSettings(resolution_m=0.02, grid="scrolling"))
    grid.prepare(CellWindow(0, 0, 1, 1), 0.0, 0.0)
    for name, layer in layers._asdict().items():
        getattr(grid.layers, name)[:] = layer
    map_ = read_out(grid, MapSettings(resolution_m=0.02), {}, rover)
    steps: dict[str, Callable[[int], object]] = {
        "motion, O(1)": lambda i: ledger.add(_motion(i)),
        "motion, read out": lambda _: place_errors(layers, centres_m, centres_m, rover),
        "fused map": lambda _: fuse_map(map_),
        **{
            f"fused, {name}": partial(_fuse, _placed(map_, *axes)) for name, axes in _PLACES.items()
        },
    }
    times = {name: _median_s(step, 15) for name, step in steps.items()}
    return [WholeMap(name, 1e3 * s, _CELLS**2 / s / 1e6) for name, s in times.items()]


def _placed(map_: ElevationMap, long_m: float, short_m: float) -> ElevationMap:
    """Return the map with every place known to these sigmas, the ellipse's axes oblique."""
    axes = Rotation.from_euler("z", 0.5).as_matrix()[:2, :2]
    xx, xy, _, yy = (axes @ np.diag([long_m**2, short_m**2]) @ axes.T).ravel()
    ones = np.ones(map_.state.shape, np.float32)
    return replace(
        map_,
        horizontal_xx_m2=np.float32(xx) * ones,
        horizontal_xy_m2=np.float32(xy) * ones,
        horizontal_yy_m2=np.float32(yy) * ones,
    )


def _fuse(map_: ElevationMap, _: int) -> None:
    fuse_map(map_)


def _median_s(work: Callable[[int], object], repeats: int) -> float:
    times = []
    for index in range(repeats):
        start = time.thread_time()
        work(index)
        times.append(time.thread_time() - start)
    return float(np.median(times))


def _print(rows: list[Row], whole: list[WholeMap], copy_gb_s: float) -> None:
    print(
        f"{'image':>8} {'cell':>6} {'map':>5} {'run':>4} {'valid':>7} {'touched':>8} "
        f"{'ms':>6} {'Mpoint/s':>9} {'load':>6} {'reduce':>7} {'update':>7} {'other':>6} "
        f"{'layers':>7} {'moved':>7} {'roofline':>9} {'numpy':>6}"
    )
    for r in rows:
        print(
            f"{r.image:>8} {r.cell_m:>5.2f}m {r.window_m:>4.0f}m {r.copies:>3}x "
            f"{r.valid_points:>7} {r.touched_cells:>8} {r.frame_ms:>6.2f} {r.mpoint_s:>9.1f} "
            f"{r.load_ns_point:>6.2f} {r.reduce_ns_point:>7.2f} {r.update_ns_cell:>7.1f} "
            f"{r.other_ms:>6.3f} {r.layers_mb:>7.1f} {r.moved_mb:>7.2f} "
            f"{r.roofline_share:>9.0%} {r.times_numpy:>5.0f}x"
        )
    print("load, reduce: ns a point; update: ns a touched cell; other: ms; layers, moved: MB")
    full = next(r for r in rows if (r.image, r.cell_m, r.window_m) == ("640x480", 0.02, 6.0))
    least_ms = full.moved_mb / copy_gb_s
    print(f"roofline: memory is copied at {copy_gb_s:.1f} GB/s, read and written together; a frame")
    print(
        f"  of 640x480 (2 cm, 6 m) moves {full.moved_mb:.1f} MB: {least_ms:.2f} ms at that speed,"
    )
    print(f"  of the {full.frame_ms:.2f} ms that it takes")
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(f"a cell takes {BYTES_PER_CELL} bytes, a motion 64; this process took {peak_mb:.0f} MB")
    for step in whole:
        print(f"{step.step:<17} {step.ms:>8.3f} ms {step.mcell_s:>12.1f} Mcell/s")
    slowest = max(step.ms for step in whole if step.step.startswith("fused"))
    print(f"slowest fused map: {slowest:.1f} ms, bar {_FUSED_BAR_MS:g} ms")


if __name__ == "__main__":
    main()
