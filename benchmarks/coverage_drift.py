"""Whether sigma stays true while poses drift: the growth of the covariance by motion.

    python benchmarks/coverage_drift.py [--worlds N] [--frames N] [--json FILE]

A rover drives half a round through each analytic world. Every motion between two frames is wrong
by 4 mm along and across and by 0.15 deg of yaw, and the errors add up; height, roll and pitch are
right. The map is judged as the rover sees it at the end: cells that are placed wrongly relative to
it have the wrong height where the ground slopes. Beside it the same map without the motions.
"""

from __future__ import annotations

import sys
from pathlib import Path

# Python puts the script's own folder first, where another file would hide the package `mapping`.
sys.path[0] = str(Path(__file__).resolve().parents[1])

import argparse
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from acquisition.messages.frames import StaticTransforms, camera_is_tracked_body
from benchmarks.coverage_worlds import CAMERA, PERIOD_S, SLOPES_DEG, nominal
from drivers.samples import DepthFrame, PoseSample, frozen_array
from mapping.judging.accuracy import Accuracy, accuracy, classes, table
from mapping.judging.evaluation import CONFIRMED, edge_cells, slope_rad
from mapping.mapper import Mapper
from mapping.motion.pose_errors import ABSOLUTE, RELATIVE
from mapping.motion.relative import RelativeMotion
from mapping.noise import NGUYEN_2012
from mapping.settings import MapSettings
from simulation.devices.ideal_camera import noisy_depth_mm, trace
from simulation.terrain.analytic import AnalyticTerrain, crater_field

Float64Array = NDArray[np.float64]

_SIGMA = np.array([0.004, 0.004, math.radians(0.15)])
# Half a round: a quarter of the two rounds of `nominal`.
_SHARE = 0.25
_NOISE = replace(NGUYEN_2012, lateral_offset_px=0.0, lateral_angle_px=0.0)
_COVARIANCE = frozen_array(np.zeros((6, 6)), (6, 6))


@dataclass(frozen=True, slots=True)
class Place:
    """Where the rover is: place and heading in the plane."""

    xy_m: Float64Array
    yaw_rad: float

    def after(self, motion: Float64Array) -> Place:
        """Return the place after a motion (x, y, yaw) in the rover's own axes."""
        return Place(self.xy_m + _turn(self.yaw_rad) @ motion[:2], self.yaw_rad + motion[2])


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", type=int, default=16)
    parser.add_argument("--frames", type=int, default=150, help="frames in each world")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    worlds = [judge_world(seed, options.frames) for seed in range(options.worlds)]
    rows: dict[str, Accuracy] = {}
    for number, name in enumerate(("drift", "ignored")):
        error, sigma, slope = np.concatenate([world[number] for world in worlds], axis=1)
        rows[name] = accuracy(error, sigma)
        for label, cells in classes(slope, SLOPES_DEG, "deg").items():
            rows[f"{name} {label}"] = accuracy(error[cells], sigma[cells])
    print("\n".join(table(rows)))
    if options.json:
        content = {name: row.as_json() for name, row in rows.items()}
        options.json.write_text(json.dumps(content, indent=2) + "\n")


def judge_world(seed: int, frames: int) -> list[Float64Array]:
    """Return (3, cells) of error, sigma and slope in degrees, with motions and without."""
    mappers = [Mapper(MapSettings(), _NOISE, pose_errors=model) for model in (RELATIVE, ABSOLUTE)]
    for mapper in mappers:
        mapper.add(StaticTransforms(0, (camera_is_tracked_body(),)))
    terrain = crater_field(seed, 6.0, 4.0)
    end = (_believed(0.0), _believed(0.0))
    for motion, pose, frame, places in _drive(terrain, np.random.default_rng(seed), frames):
        end = places
        for mapper in mappers:
            mapper.move(motion)
            mapper.add(pose)
            mapper.add(frame)
    return [_judge(mapper, terrain, *end) for mapper in mappers]


def _turn(yaw_rad: float) -> Float64Array:
    cosine, sine = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[cosine, -sine], [sine, cosine]])


def _believed(share: float) -> Place:
    _, position = nominal(_SHARE * share)
    return Place(position[:2], 4.0 * math.pi * _SHARE * share + 0.5 * math.pi)


def _drive(
    terrain: AnalyticTerrain, random: np.random.Generator, frames: int
) -> Iterator[tuple[RelativeMotion, PoseSample, DepthFrame, tuple[Place, Place]]]:
    """Give motions and poses as the rover believes, what it sees, and where it believes and is."""
    believed = true = _believed(0.0)
    sigma2 = np.diag([_SIGMA[0] ** 2, _SIGMA[1] ** 2, 0.0, _SIGMA[2] ** 2])
    for number in range(frames):
        t_ns = round(number * PERIOD_S * 1e9)
        rotation, position = nominal(_SHARE * number / frames)
        before, believed = believed, _believed(number / frames)
        driven = _turn(before.yaw_rad).T @ (believed.xy_m - before.xy_m)
        step = np.append(driven, believed.yaw_rad - before.yaw_rad)
        # The first frame ends no motion.
        covariance = sigma2 if number else np.zeros((4, 4))
        wrong = _SIGMA * random.standard_normal(3) if number else np.zeros(3)
        true = true.after(step + wrong)
        way_m = float(np.hypot(*driven))
        motion = RelativeMotion(t_ns, position, before.yaw_rad, covariance, way_m)
        turned = Rotation.from_euler("z", true.yaw_rad - believed.yaw_rad).as_matrix() @ rotation
        z_m, angle = trace(terrain, CAMERA, np.append(true.xy_m, position[2]), turned, 4.5)
        quat = Rotation.from_matrix(rotation).as_quat(scalar_first=True)
        pose = PoseSample(
            t_ns, frozen_array(position, (3,)), frozen_array(quat, (4,)), _COVARIANCE, number
        )
        depth = noisy_depth_mm(z_m, angle, random)
        yield motion, pose, DepthFrame(t_ns, depth, CAMERA, number), (believed, true)


def _judge(mapper: Mapper, terrain: AnalyticTerrain, believed: Place, true: Place) -> Float64Array:
    """Compare each cell with the ground where the rover would find it."""
    map_ = mapper.elevation_map()
    cells = np.stack(np.meshgrid(map_.x_m, map_.y_m), axis=-1)
    seen_by_rover = (cells - believed.xy_m) @ _turn(believed.yaw_rad)
    place = seen_by_rover @ _turn(true.yaw_rad).T + true.xy_m
    truth = terrain.height_m(place[..., 0], place[..., 1])
    counted = np.isin(map_.state, CONFIRMED) & ~edge_cells(truth, 1.2 * map_.resolution_m)
    slope_deg = np.degrees(slope_rad(truth, map_.resolution_m))
    return np.stack(
        [(map_.elevation_m - truth)[counted], map_.sigma_m[counted], slope_deg[counted]]
    )


if __name__ == "__main__":
    main()
