"""Maps made with estimated poses on simulated drives, judged relative to the rover's true pose.

    python benchmarks/in_the_loop.py [--seconds S] [--seeds N ...] [--drives NAME ...]
                                     [--workers N] [--json FILE]

Each drive is mapped with true poses, with ego-motion alone, and with ego-motion corrected by
alignment, with wheels and without. "spinning" is `simulation` with all wheels spinning in place
for three seconds. Every second the cells within 3 m of the rover (2 frames, 4 readings, edges
apart) are held against the ground where they truly are: q = T_true T_believed^-1 p, error = q_z -
ground(q_x, q_y). That forgives the believed pose all that map and pose share, their tilt against
gravity too; for "upright" T_true has the believed tilt, so that it counts, as it does for slopes.
ANEES and shares within one and three sigma are given for both.

Bars, for every aligned run: RMSE 6 mm, P99 14 mm, 98.5 % within three sigma, 12 ms a frame. Time is
CPU time of the thread per depth frame, median: "map ms" of the calls in which frames were aligned
and mapped, "all ms" of everything between two frames, ego-motion included.
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
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.drives import Drive, make_drive
from drivers.samples import DepthFrame, WheelTwistSample
from mapping.calibration_file import parse_noise
from mapping.cells.elevation_map import ElevationMap
from mapping.geometry import RigidTransform, UncertainPose
from mapping.judging.accuracy import anees, coverage
from mapping.judging.evaluation import CONFIRMED, EDGE_STEP_PER_CELL
from mapping.kernel_cache import compile_kernels
from mapping.mapper import Mapper
from mapping.motion.relative import yaw_of
from mapping.poses.settings import PoseSourceName
from mapping.settings import MapSettings
from simulation.devices.kinect_noise import kinect_noise_file
from simulation.terrain.height_grid import HeightGrid

Float64Array = NDArray[np.float64]

_RANGE_MAX_M = 3.0
_JUDGE_EVERY = 10  # frames


# Bars of an aligned run: name of the number, its limit, whether more is better, unit.
_BARS = (
    ("rmse_mm", 6.0, False, "mm"),
    ("p99_mm", 14.0, False, "mm"),
    ("within_3_sigma", 98.5, True, "%"),
    ("upright_within_3_sigma", 98.5, True, "%"),
    ("map_ms", 12.0, False, "ms"),
)


@dataclass(frozen=True, slots=True)
class Row:
    """One drive, mapped one way; errors in mm relative to the rover, shares in percent."""

    drive: str
    seed: int
    poses: str
    wheels: bool
    cells: int
    rmse_mm: float
    p99_mm: float
    max_mm: float
    within_1_sigma: float
    within_3_sigma: float
    anees: float
    upright_rmse_mm: float
    upright_within_1_sigma: float
    upright_within_3_sigma: float
    upright_anees: float
    way_m: float
    end_error_m: float
    aligned: int
    unaligned: int
    misfits: int
    slid: int
    map_ms: float
    all_ms: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=25.0, help="length of each drive")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 11, 12])
    parser.add_argument(
        "--drives", nargs="+", default=["simulation", "rough", "smooth", "spinning"]
    )
    parser.add_argument("--workers", type=int, default=2, help="drives at once (2)")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    compile_kernels()
    rows = []
    _print_head()
    drives = [(name, seed) for name in options.drives for seed in options.seeds]
    names, seeds = zip(*drives, strict=True)
    with ProcessPoolExecutor(options.workers, get_context("spawn")) as pool:
        for found in pool.map(measure, names, seeds, [options.seconds] * len(drives)):
            rows += found
            for row in found:
                _print(row)
    _print_bars(rows)
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=2) + "\n")


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
    times, map_times = [0.0], []
    for sample in drive.samples:
        if isinstance(sample, WheelTwistSample) and not wheels:
            continue
        mapped = len(believed)
        start = time.thread_time()
        mapper.add(sample)
        taken = time.thread_time() - start
        times[-1] += taken
        if len(believed) > mapped:
            map_times.append(taken / (len(believed) - mapped))
        if isinstance(sample, DepthFrame):
            times.append(0.0)
        if len(believed) > _JUDGE_EVERY * (len(judged) + 3):
            judged.append(_judge(mapper.elevation_map(), drive, believed[-1]))
    ms = (1e3 * float(np.median(map_times)), 1e3 * float(np.median(times)))
    return _row(drive, (poses, wheels), mapper, believed, np.concatenate(judged), ms)


def _judge(map_: ElevationMap, drive: Drive, believed: UncertainPose) -> Float64Array:
    """Return (N, 3) errors, errors upright and sigmas of the cells near the rover, edges apart."""
    cells = np.isin(map_.state, CONFIRMED) & (map_.frames >= 2) & (map_.pixels >= 4)
    rows, columns = np.nonzero(cells)
    point = np.column_stack([map_.x_m[columns], map_.y_m[rows], map_.elevation_m[cells]])
    near = np.hypot(*(point - believed.transform.translation_m)[:, :2].T) <= _RANGE_MAX_M
    point, sigma = point[near], map_.sigma_m[cells][near]
    true = drive.true_pose(believed.t_ns)
    error, smooth = _errors(true, believed.transform, point, drive.scenario.ground)
    upright, _ = _errors(
        _leaning(true, believed.transform), believed.transform, point, drive.scenario.ground
    )
    return np.column_stack([error, upright, sigma])[smooth]


def _errors(
    true: RigidTransform, believed: RigidTransform, point: Float64Array, ground: HeightGrid
) -> tuple[Float64Array, NDArray[np.bool_]]:
    """Return (N,) errors of the map's points where they truly are, and which are no edges."""
    point = (true @ believed.inverse()).apply(point)
    height = ground.height_at(point[:, 0], point[:, 1])
    return point[:, 2] - height, ~_is_edge(ground, point, height, MapSettings().resolution_m)


def _leaning(true: RigidTransform, believed: RigidTransform) -> RigidTransform:
    """Return a true pose with the roll and pitch that were believed."""
    turn = Rotation.from_euler("z", yaw_of(true) - yaw_of(believed)).as_matrix()
    return RigidTransform(turn @ believed.rotation, true.translation_m)


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
    ms: tuple[float, float],
) -> Row:
    error, upright, sigma = judged.T
    size = 1e3 * np.abs(error)
    first, last = (drive.true_pose(believed[i].t_ns) for i in (0, -1))
    end = first @ believed[0].transform.inverse() @ believed[-1].transform
    counts = mapper.counts
    return Row(
        drive=drive.name,
        seed=drive.seed,
        poses=way[0],
        wheels=way[1],
        cells=len(judged),
        rmse_mm=_rms(size),
        p99_mm=float(np.percentile(size, 99.0)),
        max_mm=float(size.max()),
        within_1_sigma=100.0 * coverage(error, sigma, 1),
        within_3_sigma=100.0 * coverage(error, sigma, 3),
        anees=anees(error, sigma),
        upright_rmse_mm=_rms(1e3 * upright),
        upright_within_1_sigma=100.0 * coverage(upright, sigma, 1),
        upright_within_3_sigma=100.0 * coverage(upright, sigma, 3),
        upright_anees=anees(upright, sigma),
        way_m=float(np.linalg.norm(np.diff(drive.motion.position_m, axis=0), axis=1).sum()),
        end_error_m=float(np.linalg.norm(end.translation_m - last.translation_m)),
        aligned=counts.aligned,
        unaligned=counts.unaligned,
        misfits=counts.misfits,
        slid=counts.slid,
        map_ms=ms[0],
        all_ms=ms[1],
    )


def _rms(values: Float64Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _print_head() -> None:
    print(
        f"{'drive':>10} {'seed':>4} {'poses':>20} {'wheels':>6} {'RMSE':>6} {'P99':>6} {'max':>5} "
        f"{'1 sig':>6} {'3 sig':>6} {'ANEES':>6} |{'RMSE':>6} {'1 sig':>6} {'3 sig':>6} "
        f"{'ANEES':>6} | {'way':>4} {'end':>6} {'aligned':>7} {'left':>4} {'slid':>4} {'map':>5} "
        f"{'all':>5}"
    )
    print(
        f"{'':>43} {'mm':>6} {'mm':>6} {'mm':>5} {'%':>6} {'%':>6} {'':>6} |{'upright':>27} | "
        f"{'m':>4} {'m':>6} {'':>17} {'ms':>5} {'ms':>5}"
    )


def _print(r: Row) -> None:
    print(
        f"{r.drive:>10} {r.seed:>4} {r.poses:>20} {'yes' if r.wheels else 'no':>6} "
        f"{r.rmse_mm:>6.2f} {r.p99_mm:>6.1f} {r.max_mm:>5.0f} {r.within_1_sigma:>6.1f} "
        f"{r.within_3_sigma:>6.2f} {r.anees:>6.2f} |{r.upright_rmse_mm:>6.2f} "
        f"{r.upright_within_1_sigma:>6.1f} {r.upright_within_3_sigma:>6.2f} "
        f"{r.upright_anees:>6.2f} | {r.way_m:>4.1f} {r.end_error_m:>6.3f} {r.aligned:>7} "
        f"{r.misfits:>4} {r.slid:>4} {r.map_ms:>5.1f} {r.all_ms:>5.1f}",
        flush=True,
    )


def _print_bars(rows: Sequence[Row]) -> None:
    """Print what all aligned runs have in common, and each bar with its worst run."""
    runs = [row for row in rows if row.aligned]
    cells = np.array([row.cells for row in runs], np.float64)
    for name in ("within_1_sigma", "within_3_sigma", "anees"):
        relative, upright = (
            np.average([getattr(row, part + name) for row in runs], weights=cells)
            for part in ("", "upright_")
        )
        print(
            f"pooled over {len(runs)} aligned runs, {name}: {relative:.2f}, upright {upright:.2f}"
        )
    for name, limit, more, unit in _BARS:
        values = [getattr(row, name) for row in runs]
        met = sum(value >= limit if more else value <= limit for value in values)
        worst = min(values) if more else max(values)
        print(
            f"{name} {'>=' if more else '<='} {limit:g} {unit}: worst {worst:.2f}, "
            f"{met} of {len(runs)} runs: {'met' if met == len(runs) else 'missed'}"
        )


if __name__ == "__main__":
    main()
