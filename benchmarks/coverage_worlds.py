"""Whether sigma is true: maps of analytic worlds, with errors that the mapper does not see.

    python benchmarks/coverage_worlds.py [--worlds N] [--frames N] [--json FILE]

A rover drives two rounds through each world, with a depth image every 0.1 s. In every run one
draw of the depth bias and of the mount's rotation; height, roll and pitch of the poses wander with
a correlation time of 0.3 s; every pixel has its own noise. The mapper knows the statistics of
these errors and nothing else. All worlds are pooled: in a single run the constant errors are one
draw, and dominate. So that twenty worlds stand for all, each constant error takes the middles of as
many equally likely intervals, in random order. Beside it the sigma that a map claims that takes
every pixel for independent ("naive").
"""

from __future__ import annotations

import sys
from pathlib import Path

# Python puts the script's own folder first, where another file would hide the package `mapping`.
sys.path[0] = str(Path(__file__).resolve().parents[1])

import argparse
import json
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import norm
from scipy.stats.qmc import LatinHypercube

from acquisition.messages.frames import StaticTransforms, camera_is_tracked_body
from drivers.samples import CameraIntrinsics, DepthFrame, PoseSample, frozen_array
from mapping.judging.accuracy import Accuracy, accuracy, classes, table
from mapping.judging.evaluation import CONFIRMED, edge_cells, slope_rad
from mapping.mapper import Mapper
from mapping.noise import NGUYEN_2012, DepthNoiseModel
from mapping.settings import MapSettings
from simulation.devices.ideal_camera import noisy_depth_mm, trace
from simulation.terrain.analytic import AnalyticTerrain, crater_field

Float64Array = NDArray[np.float64]

_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
PERIOD_S = 0.1
_CORRELATION_S = 0.3
_TILT_RAD = math.radians(0.3)
_HEIGHT_M = 0.003
_MOUNT_RAD = math.radians(0.3)
_BIAS_PER_M = 0.05 / 43.5  # 0.05 px of a Kinect's disparity
_LAPS = 2.0
_RADIUS_M = 1.2
_MIDDLE_M = (3.0, 0.0, 0.8)
# Ends of the classes; the range is that from the nearest place of the track.
SLOPES_DEG = (5.0, 10.0, 20.0)
_RANGES_M = (0.8, 1.5, 2.5)
CAMERA = CameraIntrinsics(64, 48, 58.0, 58.0, 31.5, 23.5)


@dataclass(frozen=True, slots=True)
class Judged:
    """The cells of one world: errors and sigmas of both maps, slope, distance from the track."""

    error_m: Float64Array
    sigma_m: Float64Array
    naive_error_m: Float64Array
    naive_sigma_m: Float64Array
    slope_deg: Float64Array
    range_m: Float64Array


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", type=int, default=20)
    parser.add_argument("--frames", type=int, default=1000, help="frames in each world")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    start = time.thread_time()
    draws = constant_draws(options.worlds)
    judged = [judge_world(seed, options.frames, draw) for seed, draw in enumerate(draws)]
    rows = pooled(judged)
    print("\n".join(table(rows)))
    alone = [accuracy(world.error_m, world.sigma_m).coverage_1sigma for world in judged]
    print(f"1 sigma of single worlds: {100 * min(alone):.0f} to {100 * max(alone):.0f} %")
    print(f"{time.thread_time() - start:.0f} s of CPU time")
    if options.json:
        content = {name: row.as_json() for name, row in rows.items()}
        options.json.write_text(json.dumps(content, indent=2) + "\n")


def pooled(judged: Sequence[Judged]) -> dict[str, Accuracy]:
    """Return the numbers of all worlds together, by slope and by range, and of the naive sigma."""

    def joined(name: str) -> Float64Array:
        """Return an array of all worlds, one behind the other."""
        return np.concatenate([getattr(world, name) for world in judged])

    error, sigma = joined("error_m"), joined("sigma_m")
    naive = accuracy(joined("naive_error_m"), joined("naive_sigma_m"))
    rows = {"all": accuracy(error, sigma), "naive": naive}
    for title, name, ends, unit in (
        ("slope", "slope_deg", SLOPES_DEG, "deg"),
        ("range", "range_m", _RANGES_M, "m"),
    ):
        for label, cells in classes(joined(name), ends, unit).items():
            rows[f"{title} {label}"] = accuracy(error[cells], sigma[cells])
    return rows


def constant_draws(worlds: int) -> Float64Array:
    """Return (worlds, 4) unit normal draws of mount and bias: a Latin hypercube."""
    hypercube = LatinHypercube(4, scramble=False, rng=np.random.default_rng(1))
    draws: Float64Array = norm.ppf(hypercube.random(worlds))
    return draws


def judge_world(seed: int, frames: int, constant: Float64Array) -> Judged:
    """Drive through one world; return what its confirmed cells away from edges came to.

    `constant`: (4,) unit normal draws of the mount's rotation about three axes and of the bias.
    """
    settings = MapSettings(mount_sigma_rad=_MOUNT_RAD, common_correlation_time_s=_CORRELATION_S)
    noise = replace(NGUYEN_2012, bias_sigma_quadratic_per_m=_BIAS_PER_M, lateral_offset_px=0.0)
    noise = replace(noise, lateral_angle_px=0.0)
    honest, naive = Mapper(settings, noise), _naive(noise)
    terrain = crater_field(seed, 6.0, 4.0)
    for mapper in (honest, naive):
        mapper.add(StaticTransforms(0, (camera_is_tracked_body(),)))
    for pose, frame in _drive(terrain, np.random.default_rng(seed), frames, constant):
        for mapper in (honest, naive):
            mapper.add(pose)
            mapper.add(frame)
    return _judge(terrain, honest, naive, frames)


def _naive(noise: DepthNoiseModel) -> Mapper:
    """Return a mapper that knows of pixel noise only, and believes every pixel."""
    settings = MapSettings(
        relief_share=0.0, relief_frames=0.0, common_correlation_time_s=0.0, gate_sigma=1e6
    )
    return Mapper(settings, replace(noise, bias_sigma_quadratic_per_m=0.0))


def nominal(share: float) -> tuple[Float64Array, Float64Array]:
    """Return where the rover believes the camera to be: rotation and position."""
    turn = 2.0 * math.pi * _LAPS * share
    around = _RADIUS_M * np.array([math.cos(turn), math.sin(turn), 0.0])
    heading = Rotation.from_euler("ZY", [turn + 0.5 * math.pi, math.radians(25.0)])
    return heading.as_matrix() @ _OPTICAL, np.array(_MIDDLE_M) + around


def _drive(
    terrain: AnalyticTerrain, random: np.random.Generator, frames: int, constant: Float64Array
) -> Iterator[tuple[PoseSample, DepthFrame]]:
    """Give the poses that the rover believes in, and what its camera sees from the true ones."""
    sigma = np.array([0.0, 0.0, _HEIGHT_M, _TILT_RAD, _TILT_RAD, 0.0])
    covariance = frozen_array(np.diag(sigma**2), (6, 6))
    keep = math.exp(-PERIOD_S / _CORRELATION_S)
    bias = _BIAS_PER_M * constant[3]
    crooked = Rotation.from_rotvec(_MOUNT_RAD * constant[:3]).as_matrix()
    error = sigma * random.standard_normal(6)
    for number in range(frames):
        error = keep * error + math.sqrt(1.0 - keep**2) * sigma * random.standard_normal(6)
        rotation, position = nominal(number / frames)
        true_rotation = Rotation.from_rotvec(-error[3:]).as_matrix() @ rotation @ crooked
        z_m, angle = trace(terrain, CAMERA, position - error[:3], true_rotation, 4.5)
        biased = np.where(z_m > 0.0, z_m + bias * z_m**2, 0.0)
        depth = noisy_depth_mm(biased, angle, random)
        t_ns = round(number * PERIOD_S * 1e9)
        quat = Rotation.from_matrix(rotation).as_quat(scalar_first=True)
        pose = PoseSample(
            t_ns, frozen_array(position, (3,)), frozen_array(quat, (4,)), covariance, number
        )
        yield pose, DepthFrame(t_ns, depth, CAMERA, number)


def _judge(terrain: AnalyticTerrain, honest: Mapper, naive: Mapper, frames: int) -> Judged:
    map_, other = honest.elevation_map(), naive.elevation_map()
    x, y = np.meshgrid(map_.x_m, map_.y_m)
    truth = terrain.height_m(x, y)
    counted = np.isin(map_.state, CONFIRMED) & ~edge_cells(truth, 1.2 * map_.resolution_m)
    track = np.array([nominal(n / frames)[1][:2] for n in range(0, frames, 10)])
    far_x, far_y = (axis[counted][:, np.newaxis] for axis in (x, y))
    away = np.hypot(far_x - track[:, 0], far_y - track[:, 1])
    # Both maps saw the same frames: their rectangles are the same.
    errors = [(m.elevation_m - truth)[counted].astype(np.float64) for m in (map_, other)]
    return Judged(
        error_m=errors[0],
        sigma_m=map_.sigma_m[counted].astype(np.float64),
        naive_error_m=errors[1],
        naive_sigma_m=other.sigma_m[counted].astype(np.float64),
        slope_deg=np.degrees(slope_rad(truth, map_.resolution_m))[counted],
        range_m=away.min(axis=1),
    )


if __name__ == "__main__":
    main()
