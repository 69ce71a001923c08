"""Maps made with estimated poses on simulated drives, judged relative to the rover's true pose.

    python benchmarks/in_the_loop.py [--seconds S] [--seeds N ...] [--drives NAME ...] [--json FILE]

Each drive is mapped with true poses, with ego-motion alone, and with ego-motion corrected by
alignment, with wheels and without. "spinning" is `simulation` with all wheels spinning in place
for three seconds. Every second the cells within 3 m of the rover (2 frames, 4 readings, edges
apart) are held against the ground where they truly are: q = T_true T_believed^-1 p, error = q_z -
ground(q_x, q_y). Time is CPU time of the thread per depth frame, median and mean: everything that
the mapper does between two frames, ego-motion included.
"""

from __future__ import annotations

import sys
from pathlib import Path

# Python puts the script's own folder first, where this very file would hide the package `mapping`.
sys.path[0] = str(Path(__file__).resolve().parents[1])

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from acquisition.messages.frames import StaticTransform, StaticTransforms
from drivers.errors import EndOfSource
from drivers.samples import DepthFrame, Sample, WheelTwistSample
from mapping.calibration_file import parse_noise
from mapping.cells.elevation_map import ElevationMap
from mapping.geometry import RigidTransform, UncertainPose
from mapping.judging.evaluation import CONFIRMED, EDGE_STEP_PER_CELL
from mapping.kernel_cache import compile_kernels
from mapping.mapper import Mapper
from mapping.poses.settings import PoseSourceName
from mapping.settings import MapSettings
from simulation.devices.kinect_noise import kinect_noise_file
from simulation.devices.sensor_mounts import sensor_mounts
from simulation.faults import SpinningWheels
from simulation.motion import Motion
from simulation.scenario_source import ScenarioSource
from simulation.scenarios import Scenario, make_scenario
from simulation.terrain.height_grid import HeightGrid

Float64Array = NDArray[np.float64]

_RANGE_MAX_M = 3.0
_JUDGE_EVERY = 10  # frames
_SPINNING = SpinningWheels(start_s=10.0, duration_s=3.0)


@dataclass(frozen=True, slots=True)
class Row:
    """One drive, mapped one way; errors in mm relative to the rover, shares in percent."""

    drive: str
    seed: int
    poses: str
    wheels: bool
    rmse_mm: float
    p99_mm: float
    max_mm: float
    within_1_sigma: float
    within_3_sigma: float
    anees: float
    way_m: float
    end_error_m: float
    aligned: int
    unaligned: int
    misfits: int
    slid: int
    frame_ms: float
    frame_mean_ms: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=25.0, help="length of each drive")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument(
        "--drives", nargs="+", default=["simulation", "rough", "smooth", "spinning"]
    )
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    compile_kernels()
    rows = []
    _print_head()
    for drive in options.drives:
        for seed in options.seeds:
            for row in measure(drive, seed, options.seconds):
                rows.append(row)
                _print(row)
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=2) + "\n")


@dataclass(frozen=True, slots=True)
class Drive:
    """What the devices of a drive gave, and the truth."""

    name: str
    seed: int
    scenario: Scenario
    samples: list[Sample]
    motion: Motion

    @property
    def mounts(self) -> StaticTransforms:
        """Where the sensors sit."""
        mounts = sensor_mounts(self.scenario.options, self.scenario.mount)
        return StaticTransforms(self.motion.start_ns, tuple(StaticTransform(*m) for m in mounts))

    def true_pose(self, t_ns: int) -> RigidTransform:
        """Return T_TR at a time."""
        position, quat = self.motion.pose_at(np.array([t_ns]))
        rotation = Rotation.from_quat(quat[0], scalar_first=True).as_matrix()
        return RigidTransform(rotation, position[0])


def make_drive(name: str, seed: int, seconds: float) -> Drive:
    """Drive, and keep all samples in the order of their stamps."""
    scenario = make_scenario("simulation" if name == "spinning" else name, seed, seconds)
    if name == "spinning":
        scenario = replace(scenario, options=replace(scenario.options, faults=(_SPINNING,)))
    source = ScenarioSource(scenario)
    source.open()
    samples: list[Sample] = []
    try:
        while True:
            samples += source.read(0.0)
    except EndOfSource:
        source.close()
    return Drive(name, seed, scenario, samples, source.motion)


def measure(name: str, seed: int, seconds: float) -> list[Row]:
    """Return the rows of one drive."""
    drive = make_drive(name, seed, seconds)
    ways = [("mocap", True), ("ego-motion", True)]
    ways += [("ego-motion+alignment", wheels) for wheels in (True, False)]
    return [map_drive(drive, cast(PoseSourceName, poses), wheels) for poses, wheels in ways]


def map_drive(drive: Drive, poses: PoseSourceName, wheels: bool) -> Row:
    """Map a drive and judge the map every second."""
    believed: list[UncertainPose] = []
    noise = parse_noise(json.dumps(kinect_noise_file(drive.scenario.camera.model)), "simulation")
    mapper = Mapper(MapSettings(pose_source=poses), noise, on_pose=believed.append)
    mapper.add(drive.mounts)
    judged: list[Float64Array] = []
    times = [0.0]
    for sample in drive.samples:
        if isinstance(sample, WheelTwistSample) and not wheels:
            continue
        start = time.thread_time()
        mapper.add(sample)
        times[-1] += time.thread_time() - start
        if isinstance(sample, DepthFrame):
            times.append(0.0)
        if len(believed) > _JUDGE_EVERY * (len(judged) + 3):
            judged.append(_judge(mapper.elevation_map(), drive, believed[-1]))
    return _row(drive, (poses, wheels), mapper, believed, np.concatenate(judged), times)


def _judge(map_: ElevationMap, drive: Drive, believed: UncertainPose) -> Float64Array:
    """Return (N, 2) errors and sigmas of the cells near the rover, edges apart."""
    cells = np.isin(map_.state, CONFIRMED) & (map_.frames >= 2) & (map_.pixels >= 4)
    rows, columns = np.nonzero(cells)
    point = np.column_stack([map_.x_m[columns], map_.y_m[rows], map_.elevation_m[cells]])
    true = drive.true_pose(believed.t_ns)
    point = (true @ believed.transform.inverse()).apply(point)
    near = np.hypot(*(point - true.translation_m)[:, :2].T) <= _RANGE_MAX_M
    point, sigma = point[near], map_.sigma_m[cells][near]
    ground = drive.scenario.ground
    height = ground.height_at(point[:, 0], point[:, 1])
    smooth = ~_is_edge(ground, point, height, map_.resolution_m)
    return np.column_stack([point[:, 2] - height, sigma])[smooth]


def _is_edge(
    ground: HeightGrid, point: Float64Array, height: Float64Array, cell_m: float
) -> NDArray[np.bool_]:
    edge = np.zeros(len(point), np.bool_)
    for dx, dy in ((cell_m, 0.0), (-cell_m, 0.0), (0.0, cell_m), (0.0, -cell_m)):
        step = ground.height_at(point[:, 0] + dx, point[:, 1] + dy) - height
        edge |= np.abs(step) > EDGE_STEP_PER_CELL * cell_m
    return edge


def _row(
    drive: Drive,
    way: tuple[str, bool],
    mapper: Mapper,
    believed: list[UncertainPose],
    judged: Float64Array,
    times: list[float],
) -> Row:
    error, ratio = np.abs(judged[:, 0]), np.abs(judged[:, 0] / judged[:, 1])
    first, last = (drive.true_pose(believed[i].t_ns) for i in (0, -1))
    end = first @ believed[0].transform.inverse() @ believed[-1].transform
    counts = mapper.counts
    return Row(
        drive=drive.name,
        seed=drive.seed,
        poses=way[0],
        wheels=way[1],
        rmse_mm=1e3 * float(np.sqrt(np.mean(error**2))),
        p99_mm=1e3 * float(np.percentile(error, 99.0)),
        max_mm=1e3 * float(error.max()),
        within_1_sigma=100.0 * float(np.mean(ratio <= 1.0)),
        within_3_sigma=100.0 * float(np.mean(ratio <= 3.0)),
        anees=float(np.mean(ratio**2)),
        way_m=float(np.linalg.norm(np.diff(drive.motion.position_m, axis=0), axis=1).sum()),
        end_error_m=float(np.linalg.norm(end.translation_m - last.translation_m)),
        aligned=counts.aligned,
        unaligned=counts.unaligned,
        misfits=counts.misfits,
        slid=counts.slid,
        frame_ms=1e3 * float(np.median(times)),
        frame_mean_ms=1e3 * float(np.mean(times)),
    )


def _print_head() -> None:
    print(
        f"{'drive':>10} {'seed':>4} {'poses':>20} {'wheels':>6} {'RMSE':>6} {'P99':>6} {'max':>5} "
        f"{'1 sig':>6} {'3 sig':>6} {'ANEES':>6} {'way':>5} {'end':>6} {'aligned':>7} {'left':>4} "
        f"{'slid':>4} {'ms':>5} {'mean':>5}"
    )
    print(f"{'':>43} {'mm':>6} {'mm':>6} {'mm':>5} {'%':>6} {'%':>6} {'':>6} {'m':>5} {'m':>6}")


def _print(r: Row) -> None:
    print(
        f"{r.drive:>10} {r.seed:>4} {r.poses:>20} {'yes' if r.wheels else 'no':>6} "
        f"{r.rmse_mm:>6.2f} {r.p99_mm:>6.1f} {r.max_mm:>5.0f} {r.within_1_sigma:>6.1f} "
        f"{r.within_3_sigma:>6.2f} {r.anees:>6.2f} {r.way_m:>5.1f} {r.end_error_m:>6.3f} "
        f"{r.aligned:>7} {r.misfits:>4} {r.slid:>4} {r.frame_ms:>5.1f} {r.frame_mean_ms:>5.1f}",
        flush=True,
    )


if __name__ == "__main__":
    main()
