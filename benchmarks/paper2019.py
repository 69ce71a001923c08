"""The printed equations beside the corrected ones, on drives whose terrain is known.

    python benchmarks/paper2019.py [--seconds S] [--seeds N] [--json FILE]

The ideal drive: exact or uncertain poses, Nguyen's noise. In the uncertain case every frame's pose
is off by 2 mm and 0.1 degrees (white, one sigma), which both modes are told. Edges are left out;
coverage and ANEES are of confirmed cells, all seeds together.
"""

from __future__ import annotations

import sys
from pathlib import Path

# Python puts the script's own folder first, where `mapping.py` would hide the package.
sys.path[0] = str(Path(__file__).resolve().parents[1])

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from acquisition.messages.frames import StaticTransforms, camera_is_tracked_body
from drivers.samples import PoseSample, Sample, frozen_array
from mapping.calibration_file import parse_noise
from mapping.cells.elevation_map import CellState
from mapping.judging.accuracy import accuracy
from mapping.judging.evaluation import edge_cells
from mapping.mapper import Mapper
from mapping.paper2019.faults import FAULTS
from mapping.paper2019.paper_mapper import PaperMapper
from mapping.settings import MapSettings
from simulation.devices.ideal_camera import IDEAL_CAMERA_NOISE
from simulation.ideal_drive import IdealDrive

Float64Array = NDArray[np.float64]
_METHODS = {"corrected": Mapper, "paper2019": PaperMapper}
_SIGMA_M, _SIGMA_RAD = 0.002, float(np.radians(0.1))


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table."""

    poses: str
    method: str
    cells: int
    rmse_m: float
    sigma_median_m: float
    coverage_1sigma: float
    coverage_3sigma: float
    anees: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=6.0, help="of each drive")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    rows = _rows(options.seconds, options.seeds)
    print(
        f"{'poses':>10} {'method':>10} {'cells':>7} {'RMSE mm':>8} {'sigma mm':>9} "
        f"{'1 sigma':>8} {'3 sigma':>8} {'ANEES':>8}"
    )
    for r in rows:
        print(
            f"{r.poses:>10} {r.method:>10} {r.cells:>7} {1e3 * r.rmse_m:>8.2f} "
            f"{1e3 * r.sigma_median_m:>9.2f} {r.coverage_1sigma:>8.1%} {r.coverage_3sigma:>8.1%} "
            f"{r.anees:>8.2f}"
        )
    for number, fault in enumerate(FAULTS, 1):
        print(f"{number}. {fault}")
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=2) + "\n")


def _rows(seconds: float, seeds: int) -> list[Row]:
    found: dict[tuple[str, str], list[tuple[Float64Array, Float64Array]]] = {}
    for seed in range(seeds):
        drive = IdealDrive(seed, seconds)
        drive.open()
        samples = [sample for _ in range(drive.frames) for sample in drive.read(0.0)]
        for poses, stream in (("exact", samples), ("uncertain", _disturbed(samples, seed))):
            for method in _METHODS:
                found.setdefault((poses, method), []).append(_errors(drive, stream, method))
    return [
        _row(*names, *map(np.concatenate, zip(*runs, strict=True))) for names, runs in found.items()
    ]


def _disturbed(samples: list[Sample], seed: int) -> list[Sample]:
    """Return the stream with poses that are off, and say so in their covariance."""
    random = np.random.default_rng([99, seed])
    variances = [_SIGMA_M**2] * 3 + [_SIGMA_RAD**2] * 3
    return [
        _off(sample, random, np.diag(variances)) if isinstance(sample, PoseSample) else sample
        for sample in samples
    ]


def _off(pose: PoseSample, random: np.random.Generator, covariance: Float64Array) -> PoseSample:
    turn = Rotation.from_rotvec(_SIGMA_RAD * random.standard_normal(3))
    rotation = turn * Rotation.from_quat(pose.quat_wxyz, scalar_first=True)
    return replace(
        pose,
        position_m=frozen_array(pose.position_m + _SIGMA_M * random.standard_normal(3), (3,)),
        quat_wxyz=frozen_array(rotation.as_quat(scalar_first=True), (4,)),
        covariance=frozen_array(covariance, (6, 6)),
    )


def _errors(
    drive: IdealDrive, samples: list[Sample], method: str
) -> tuple[Float64Array, Float64Array]:
    """Return error and sigma of the confirmed cells, edges apart."""
    noise = parse_noise(json.dumps(IDEAL_CAMERA_NOISE), "the ideal camera")
    # White errors: nothing is alike from frame to frame.
    mapper = _METHODS[method](MapSettings(common_correlation_time_s=0.0), noise)
    mapper.add(StaticTransforms(0, (camera_is_tracked_body(),)))
    for sample in samples:
        mapper.add(sample)
    mapper.finish()
    map_ = mapper.elevation_map()
    truth = drive.terrain.height_m(map_.x_m[np.newaxis, :], map_.y_m[:, np.newaxis])
    confirmed = np.isin(map_.state, (CellState.MEASURED, CellState.UNCERTAIN))
    counted = confirmed & ~edge_cells(truth, 1.2 * map_.resolution_m)
    error = map_.elevation_m.astype(np.float64) - truth
    return error[counted], map_.sigma_m[counted].astype(np.float64)


def _row(poses: str, method: str, error: Float64Array, sigma: Float64Array) -> Row:
    scores = accuracy(error, sigma)
    return Row(
        poses,
        method,
        error.size,
        float(np.sqrt(np.mean(error**2))),
        float(np.median(sigma)),
        scores.coverage_1sigma,
        scores.coverage_3sigma,
        scores.anees,
    )


if __name__ == "__main__":
    main()
