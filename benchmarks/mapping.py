"""Speed of the mapping steps on one core, beside two yardsticks measured in the same run.

    python benchmarks/mapping.py [--frames N] [--json FILE]

The scene is analytic terrain seen from 0.6 m height, 25 degrees down, while the camera turns.
Time is CPU time of the thread, median over the frames. Yardsticks: a plain numpy version of the
same measurement (float64, bincount), and copying the depth image in memory.
"""

from __future__ import annotations

import sys
from pathlib import Path

# Python puts the script's own folder first, where this very file would hide the package `mapping`.
sys.path[0] = str(Path(__file__).resolve().parents[1])

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from drivers.samples import CameraIntrinsics
from mapping.cells.grid import make_grid
from mapping.cells.update_constants import fusion_constants
from mapping.cells.update_kernels import fuse
from mapping.geometry import RigidTransform, UncertainPose
from mapping.kernel_cache import compile_kernels
from mapping.measurement import FrameReducer, View
from mapping.motion.ledger import at_rest
from mapping.noise import NGUYEN_2012
from mapping.settings import MapSettings
from simulation.devices.ideal_camera import noisy_depth_mm, trace
from simulation.terrain.analytic import crater_field

Float64Array = NDArray[np.float64]
_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_VIEWS = 8


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table; times in ms per frame, shares of the frame's time."""

    image: str
    cell_m: float
    valid_points: int
    frame_ms: float
    mpoint_s: float
    load_share: float
    reduce_share: float
    update_share: float
    other_share: float
    numpy_ms: float
    times_numpy: float
    copy_ms: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=200, help="frames for each row")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    compile_kernels()
    rows = [
        measure(camera, cell_m, options.frames)
        for camera in (_camera(320), _camera(640))
        for cell_m in (0.02, 0.05)
    ]
    _print(rows)
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=2) + "\n")


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


def measure(camera: CameraIntrinsics, cell_m: float, frames: int) -> Row:
    """Return the times of mapping `frames` frames of that size into cells of that size."""
    settings = MapSettings(resolution_m=cell_m)
    reducer = FrameReducer(camera, NGUYEN_2012, settings)
    grid = make_grid(settings)
    fusion = fusion_constants(settings)
    motions = at_rest()
    images = _images(camera)
    laps: list[dict[str, float]] = []
    points: list[int] = []
    for index in range(frames + _VIEWS):
        view = _view(index)
        clock = _Clock()
        points.append(reducer.load(images[index % _VIEWS]))
        clock.lap("load")
        window = grid.prepare(reducer.footprint(view), 2.0, 0.0)
        clock.lap("other")
        sums, _ = reducer.reduce(view, window)
        clock.lap("reduce")
        constants = reducer.frame_constants(view, window, grid.position(window))
        clock.lap("other")
        fuse(sums, constants, fusion, grid.layers, motions)
        clock.lap("update")
        laps.append(clock.laps)
    return _row(camera, cell_m, laps[_VIEWS:], points[_VIEWS:], images)


def _row(
    camera: CameraIntrinsics,
    cell_m: float,
    laps: list[dict[str, float]],
    points: list[int],
    images: list[NDArray[np.uint16]],
) -> Row:
    totals = np.array([sum(lap.values()) for lap in laps])
    frame_s = float(np.median(totals))
    shares = {name: float(np.median([lap[name] for lap in laps])) / frame_s for name in laps[0]}
    numpy_s = _median_s(lambda i: _numpy_frame(images[i % _VIEWS], camera, cell_m, _view(i)), 5)
    copy_s = _median_s(lambda i: images[i % _VIEWS].copy(), 50)
    return Row(
        image=f"{camera.width_px}x{camera.height_px}",
        cell_m=cell_m,
        valid_points=int(np.median(points)),
        frame_ms=1e3 * frame_s,
        mpoint_s=float(np.median(np.array(points) / totals)) / 1e6,
        load_share=shares["load"],
        reduce_share=shares["reduce"],
        update_share=shares["update"],
        other_share=shares["other"],
        numpy_ms=1e3 * numpy_s,
        times_numpy=numpy_s / frame_s,
        copy_ms=1e3 * copy_s,
    )


def _median_s(work: Callable[[int], object], repeats: int) -> float:
    times = []
    for index in range(repeats):
        start = time.thread_time()
        work(index)
        times.append(time.thread_time() - start)
    return float(np.median(times))


def _numpy_frame(
    depth_mm: NDArray[np.uint16], camera: CameraIntrinsics, cell_m: float, view: View
) -> Float64Array:
    """Height, variance with incidence angle and sums per cell, as one would write it in numpy."""
    z = depth_mm * 1e-3
    v, u = np.nonzero((z > 0.4) & (z < 4.0))
    slope_y, slope_x = (g[v, u] for g in np.gradient(z))
    z = z[v, u]
    ray = np.stack(
        [(u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px, np.ones_like(z)]
    )
    a, b = camera.fx_px * slope_x, camera.fy_px * slope_y
    normal = np.sqrt(a**2 + b**2 + (z + ray[0] * a + ray[1] * b) ** 2)
    length = np.sqrt((ray**2).sum(axis=0))
    theta = np.minimum(np.arccos(np.clip(z / (normal * length), 0.0, 1.0)), 1.466)
    ratio = theta / (np.pi / 2 - theta)
    sigma = 0.0012 + 0.0019 * (z - 0.4) ** 2 + 0.0001 / np.sqrt(z) * ratio**2
    lateral = (0.8 + 0.035 * ratio) * z / 580.0
    direction = view.T_terrain_sensor.rotation @ ray
    variance = (sigma * direction[2]) ** 2 + lateral**2 * (1 - (direction[2] / length) ** 2)
    x, y = z * direction[:2] + view.T_terrain_sensor.translation_m[:2, np.newaxis]
    column, row = np.floor(x / cell_m).astype(int), np.floor(y / cell_m).astype(int)
    column -= column.min()
    row -= row.min()
    index = row * (column.max() + 1) + column
    height, weight = z * direction[2], 1.0 / variance
    return np.stack([np.bincount(index, w) for w in (weight, weight * height, weight * height**2)])


def _print(rows: list[Row]) -> None:
    print(
        f"{'image':>8} {'cell':>6} {'valid':>7} {'ms/frame':>9} {'Mpoint/s':>9} "
        f"{'load':>6} {'reduce':>7} {'update':>7} {'other':>6} {'numpy ms':>9} {'faster':>7} "
        f"{'copy ms':>8}"
    )
    for r in rows:
        print(
            f"{r.image:>8} {r.cell_m:>5.2f}m {r.valid_points:>7} {r.frame_ms:>9.2f} "
            f"{r.mpoint_s:>9.1f} {r.load_share:>6.0%} {r.reduce_share:>7.0%} "
            f"{r.update_share:>7.0%} {r.other_share:>6.0%} {r.numpy_ms:>9.1f} "
            f"{r.times_numpy:>6.0f}x {r.copy_ms:>8.3f}"
        )


if __name__ == "__main__":
    main()
