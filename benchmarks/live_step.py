"""One live step on one core with everything on: what a frame costs from depth image to layers.

    python benchmarks/live_step.py [--frames N] [--json FILE]

A rover on analytic terrain turns on the spot, 0.6 m above the ground, the camera 25 degrees down;
the map is a scrolling window of 300 x 300 cells. In every frame: a motion whose covariance grows
that of the cells; readings, rover's own body, overhangs; noise with incidence angle, sums per cell,
gate, clean-up by visibility, hidden cells, update; then the map is read out as a whole, fused over
the places' errors as a whole and derived layers are computed as a whole. Time is CPU time of the
thread, median over the frames; the sum's median is of the sums.
"""

from __future__ import annotations

import sys
from pathlib import Path

# Python puts the script's own folder first, where `mapping.py` would hide the package.
sys.path[0] = str(Path(__file__).resolve().parents[1])

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from acquisition.messages.frames import (
    BASE_FRAME,
    DEPTH_OPTICAL_FRAME,
    MOCAP_BODY_FRAME,
    StaticTransform,
    StaticTransforms,
)
from drivers.samples import CameraIntrinsics, DepthFrame, PoseSample, frozen_array
from mapping.ground.fusion import fuse_map
from mapping.ground.layers import derive
from mapping.kernel_cache import compile_kernels
from mapping.mapper import Mapper
from mapping.motion.pose_errors import RELATIVE
from mapping.motion.relative import RelativeMotion
from mapping.noise import NGUYEN_2012
from mapping.settings import MapSettings
from simulation.devices.ideal_camera import noisy_depth_mm, trace
from simulation.devices.kinect import kinect_320, kinect_640
from simulation.terrain.analytic import crater_field

_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_VIEWS = 8
_CELLS = 300
_HEIGHT_M = 0.6
_BODY_M = ((-0.5, -0.4, -0.6, 0.3, 0.4, -0.05), (0.2, -0.1, -0.4, 0.6, 0.1, -0.1))
_STEPS = ("frame", "read out", "fused map", "layers")
_BAR_MS = 20.0


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table; ms of CPU a frame."""

    image: str
    cell_m: float
    place_cm: float
    confirmed_cells: int
    frame_ms: float
    read_out_ms: float
    fused_map_ms: float
    layers_ms: float
    step_ms: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=60, help="frames for each row")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    compile_kernels()
    cases = [
        (camera, cell_m, motion_m)
        for camera in (kinect_320(), kinect_640())
        for cell_m in (0.02, 0.04)
        for motion_m in (1e-4, 2e-3)
    ]
    rows = [measure(*case, options.frames) for case in cases]
    print(
        f"{'image':>8} {'cell':>6} {'place':>8} {'cells':>6} "
        + " ".join(f"{name + ' ms':>12}" for name in (*_STEPS, "whole step"))
    )
    for r in rows:
        times = (r.frame_ms, r.read_out_ms, r.fused_map_ms, r.layers_ms, r.step_ms)
        print(
            f"{r.image:>8} {r.cell_m:>5.2f}m {r.place_cm:>6.1f}cm {r.confirmed_cells:>6} "
            + " ".join(f"{ms:>12.2f}" for ms in times)
        )
    slowest = max(r.step_ms for r in rows if r.image == "640x480")
    print(
        "place: median sigma of the cells' places, the longer axis; cells: confirmed, of "
        f"{_CELLS} x {_CELLS}"
    )
    print(f"whole step at 640x480, everything on: {slowest:.1f} ms, bar {_BAR_MS:g} ms")
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=2) + "\n")


def measure(camera: CameraIntrinsics, cell_m: float, motion_m: float, frames: int) -> Row:
    """Return the times with motions of that sigma."""
    settings = MapSettings(
        resolution_m=cell_m,
        grid="scrolling",
        window_m=_CELLS * cell_m,
        overhang_clearance_m=0.5,
        body_boxes_m=_BODY_M,
    )
    mapper = Mapper(settings, NGUYEN_2012, pose_errors=RELATIVE)
    mapper.add(_mounts())
    images = _images(camera)
    times = np.zeros((frames, len(_STEPS)))
    for n in range(-2 * _VIEWS, frames):
        frame = DepthFrame(_pose(n).t_ns, images[n % _VIEWS], camera, n + 2 * _VIEWS)
        clock = [time.thread_time()]
        mapper.move(_motion(n, motion_m))
        mapper.add(_pose(n))
        mapper.add(frame)
        clock.append(time.thread_time())
        map_ = mapper.read_map({})
        clock.append(time.thread_time())
        fuse_map(map_)
        clock.append(time.thread_time())
        derive(map_)
        clock.append(time.thread_time())
        if n >= 0:
            times[n] = np.diff(clock)
    confirmed = np.isfinite(map_.elevation_m) & (map_.state > 1)
    half = 0.5 * (map_.horizontal_xx_m2 - map_.horizontal_yy_m2)[confirmed]
    middle = 0.5 * (map_.horizontal_xx_m2 + map_.horizontal_yy_m2)[confirmed]
    longest = np.sqrt(middle + np.hypot(half, map_.horizontal_xy_m2[confirmed]))
    frame_ms, read_out_ms, fused_map_ms, layers_ms = (1e3 * np.median(times, axis=0)).tolist()
    return Row(
        f"{camera.width_px}x{camera.height_px}",
        cell_m,
        1e2 * float(np.median(longest)),
        int(np.count_nonzero(confirmed)),
        frame_ms,
        read_out_ms,
        fused_map_ms,
        layers_ms,
        1e3 * float(np.median(times.sum(axis=1))),
    )


def _rotation(n: int) -> np.ndarray:
    heading = 2.0 * np.pi * (n % _VIEWS) / _VIEWS
    matrix: np.ndarray = Rotation.from_euler("ZY", [heading, np.radians(25.0)]).as_matrix()
    return matrix


def _images(camera: CameraIntrinsics) -> list[np.ndarray]:
    terrain = crater_field(1, 12.0, 12.0)
    images = []
    for n in range(_VIEWS):
        origin = np.array([0.0, 0.0, _HEIGHT_M])
        z_m, angle = trace(terrain, camera, origin, _rotation(n) @ _OPTICAL, 4.5)
        images.append(noisy_depth_mm(z_m, angle, np.random.default_rng(n)))
    return images


def _mounts() -> StaticTransforms:
    quat = Rotation.from_matrix(_OPTICAL).as_quat(scalar_first=True)
    nowhere, level = frozen_array((0, 0, 0), (3,)), frozen_array((1, 0, 0, 0), (4,))
    return StaticTransforms(
        0,
        (
            StaticTransform(
                MOCAP_BODY_FRAME, DEPTH_OPTICAL_FRAME, nowhere, frozen_array(quat, (4,))
            ),
            StaticTransform(MOCAP_BODY_FRAME, BASE_FRAME, nowhere, level),
        ),
    )


def _pose(n: int) -> PoseSample:
    quat = Rotation.from_matrix(_rotation(n)).as_quat(scalar_first=True)
    return PoseSample(
        (n + 2 * _VIEWS) * 33_000_000,
        frozen_array((0, 0, _HEIGHT_M), (3,)),
        frozen_array(quat, (4,)),
        frozen_array(1e-6 * np.eye(6), (6, 6)),
        n,
    )


def _motion(n: int, sigma_m: float) -> RelativeMotion:
    covariance = sigma_m**2 * np.diag([1.0, 1.0, 1e-2, 0.1])
    return RelativeMotion(n * 33_000_000, np.array([0.0, 0.0, _HEIGHT_M]), 0.8 * n, covariance, 0.0)


if __name__ == "__main__":
    main()
