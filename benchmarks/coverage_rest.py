"""Whether sigma is true for a camera that rests, or creeps, on flat ground.

    python benchmarks/coverage_rest.py [--seconds S] [--speed M_S] [--json FILE]

A simulated Kinect at several heights and tilts over planes of slightly different inclination, 10
frames a second, exact poses. "blurred steps": the simulated sensor, whose noise of half a depth
step blurs the steps. "bare steps": the depth steps alone. "uncalibrated": the first, mapped with
kinect-v1. By distance from the camera over the ground.
"""

from __future__ import annotations

import sys
from pathlib import Path

# Python puts the script's own folder first, where another file would hide the package `mapping`.
sys.path[0] = str(Path(__file__).resolve().parents[1])

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from acquisition.messages.frames import StaticTransforms, camera_is_tracked_body
from drivers.samples import DepthFrame, PoseSample, frozen_array
from mapping.calibration_file import parse_noise
from mapping.judging.accuracy import Accuracy, accuracy, classes, table
from mapping.judging.evaluation import CONFIRMED
from mapping.mapper import Mapper
from mapping.noise import KINECT_V1, DepthNoiseModel
from mapping.settings import MapSettings
from simulation.devices.camera_mount import BODY_FROM_OPTICAL
from simulation.devices.kinect import CleanView, KinectModel, kinect_320, kinect_depth_mm
from simulation.devices.kinect_noise import kinect_noise_file

Float64Array = NDArray[np.float64]

CAMERA = kinect_320()
PERIOD_S = 0.1
# Height and tilt of the camera, m and degrees.
_STANDS = ((0.4, 25.0), (0.4, 15.0), (0.6, 30.0), (0.8, 25.0), (0.3, 20.0))
_INCLINED_RAD = 0.03
_FARTHEST_M = 6.0
_RANGES_M = (1.0, 1.5, 2.0, 3.0)
_NO_ERROR = frozen_array(np.zeros((6, 6)), (6, 6))


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--speed", type=float, default=0.0, metavar="M_S", help="of creeping")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    start = time.thread_time()
    content = {}
    for name, (sensor, noise) in _sensors().items():
        rows = judged(sensor, noise, round(options.seconds / PERIOD_S), options.speed)
        print("\n".join([name, *table(rows), ""]))
        content[name] = {label: row.as_json() for label, row in rows.items()}
    print(f"{time.thread_time() - start:.0f} s of CPU time")
    if options.json:
        options.json.write_text(json.dumps(content, indent=2) + "\n")


def _sensors() -> dict[str, tuple[KinectModel, DepthNoiseModel]]:
    blurred = KinectModel()
    bare = replace(blurred, sigma_disparity_px=0.0, floor_sigma_m=0.0003)
    bare_noise = replace(_noise_of(bare), fixed_share=1.0)
    return {
        "blurred steps": (blurred, _noise_of(blurred)),
        "bare steps": (bare, bare_noise),
        "uncalibrated": (blurred, KINECT_V1),
    }


def _noise_of(sensor: KinectModel) -> DepthNoiseModel:
    return parse_noise(json.dumps(kinect_noise_file(sensor)), "the simulated sensor")


def judged(
    sensor: KinectModel, noise: DepthNoiseModel, frames: int, speed_m_s: float
) -> dict[str, Accuracy]:
    """Return the numbers of all stands together, and by range."""
    parts = [_stand(sensor, noise, frames, speed_m_s, number) for number in range(len(_STANDS))]
    error, sigma, away = np.concatenate(parts, axis=1)
    rows = {"all": accuracy(error, sigma)}
    for label, cells in classes(away, _RANGES_M, "m").items():
        rows[f"range {label}"] = accuracy(error[cells], sigma[cells])
    return rows


def _stand(
    sensor: KinectModel, noise: DepthNoiseModel, frames: int, speed_m_s: float, number: int
) -> Float64Array:
    """Return (3, cells): error, sigma and distance of the confirmed cells of one stand."""
    height_m, tilt_deg = _STANDS[number]
    random = np.random.default_rng(number)
    normal = np.array([*_INCLINED_RAD * random.standard_normal(2), 1.0])
    yaw = random.uniform(0.0, 2.0 * np.pi)
    first = np.array([*random.uniform(-1.0, 1.0, 2), height_m])
    step = speed_m_s * PERIOD_S * np.array([np.cos(yaw), np.sin(yaw), 0.0])
    turn = Rotation.from_euler("ZY", [yaw, np.radians(tilt_deg)]).as_matrix()
    rotation = turn @ BODY_FROM_OPTICAL
    quat = frozen_array(Rotation.from_matrix(rotation).as_quat(scalar_first=True), (4,))
    mapper = Mapper(MapSettings(), noise)
    mapper.add(StaticTransforms(0, (camera_is_tracked_body(),)))
    for k in range(frames):
        position = first + k * step
        view = _look(rotation, position, normal)
        t_ns = round(k * PERIOD_S * 1e9)
        mapper.add(PoseSample(t_ns, frozen_array(position, (3,)), quat, _NO_ERROR, k))
        mapper.add(DepthFrame(t_ns, kinect_depth_mm(view, CAMERA, sensor, random), CAMERA, k))
    map_ = mapper.elevation_map()
    x, y = np.meshgrid(map_.x_m, map_.y_m)
    error = map_.elevation_m + normal[0] * x + normal[1] * y
    away = np.hypot(x - position[0], y - position[1])
    counted = np.isin(map_.state, CONFIRMED)
    return np.stack([error[counted], map_.sigma_m[counted], away[counted]]).astype(np.float64)


def _look(rotation: Float64Array, position: Float64Array, normal: Float64Array) -> CleanView:
    """Return the clean view of the plane through the origin."""
    x = (np.arange(CAMERA.width_px) - CAMERA.cx_px) / CAMERA.fx_px
    y = (np.arange(CAMERA.height_px) - CAMERA.cy_px) / CAMERA.fy_px
    rays = np.stack(np.broadcast_arrays(x, y[:, np.newaxis], 1.0), axis=-1)
    falling = -(rays @ rotation.T @ normal)
    z_m = np.where(falling > 0.0, position @ normal / np.maximum(falling, 1e-9), 0.0)
    z_m = np.where(z_m < _FARTHEST_M, z_m, 0.0)
    length = np.linalg.norm(rays, axis=-1) * np.linalg.norm(normal)
    return CleanView(z_m, np.where(z_m > 0.0, falling / length, 1.0), np.zeros_like(z_m))


if __name__ == "__main__":
    main()
