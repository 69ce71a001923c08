"""Speed of the simulated depth camera on one core, beside two yardsticks of the same run.

    python benchmarks/depth_camera.py [--frames N] [--json FILE]

The scene is nominal lunar ground seen from the rover's camera. Time is CPU time of the thread,
median over the frames. Yardsticks: one height per pixel on the same triangles, the least that any
caster computes, and copying the depth image in memory.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from drivers.samples import CameraIntrinsics
from simulation.devices.camera_mount import on_rover
from simulation.devices.depth_camera import DepthCamera
from simulation.devices.kinect import KinectModel, kinect_320, kinect_640
from simulation.terrain.height_grid import HeightGrid
from simulation.terrain.lunar_terrain import lunar_terrain


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table; times in ms per frame."""

    image: str
    cast_ms: float
    sensor_ms: float
    heights_ms: float
    copy_ms: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=40, help="frames for each row")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    ground = lunar_terrain("nominal", 1).grid
    rows = [measure(ground, camera, options.frames) for camera in (kinect_320(), kinect_640())]
    print(f"{'image':10} {'cast':>8} {'sensor':>8} {'heights':>8} {'copy':>8}  ms per frame")
    for row in rows:
        times = (row.cast_ms, row.sensor_ms, row.heights_ms, row.copy_ms)
        print(f"{row.image:10} " + " ".join(f"{ms:8.2f}" for ms in times))
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=2) + "\n")


def measure(ground: HeightGrid, camera: CameraIntrinsics, frames: int) -> Row:
    """Return the times of one image size while the rover turns on the spot."""
    eye = DepthCamera(ground, camera, KinectModel(), 1)
    turns = Rotation.from_euler("z", np.linspace(0.0, 5.0, frames)[:, np.newaxis]).as_matrix()
    poses = [on_rover().camera_pose(np.array([2.0, 0.0, 0.1]), turn) for turn in turns]
    views = [eye.look(*pose) for pose in poses]
    x, y = np.random.default_rng(0).uniform(0.0, 4.0, (2, views[0].z_m.size))
    ground.height_at(x, y)
    return Row(
        f"{camera.width_px}x{camera.height_px}",
        _median_ms(frames, lambda i: eye.look(*poses[i])),
        _median_ms(frames, lambda i: eye.frame(views[i], i, 0)),
        _median_ms(frames, lambda _: ground.height_at(x, y)),
        _median_ms(frames, lambda i: views[i].z_m.astype(np.uint16)),
    )


def _median_ms(frames: int, step: Callable[[int], object]) -> float:
    times = []
    for i in range(frames):
        start = time.thread_time()
        step(i)
        times.append(time.thread_time() - start)
    return 1000.0 * float(np.median(times))


if __name__ == "__main__":
    main()
