"""Short drives over terrain whose height is known everywhere, from samples to map."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import pytest

from drivers.samples import DepthFrame
from mapping.calibration_file import parse_noise
from mapping.cells.elevation_map import ElevationMap
from mapping.judging.accuracy import Accuracy, accuracy
from mapping.judging.evaluation import CONFIRMED, edge_cells
from mapping.judging.truth import Truth, evaluate_truth
from mapping.mapper import Mapper, MapperCounts
from mapping.settings import MapSettings
from simulation.devices.ideal_camera import IDEAL_CAMERA_NOISE
from simulation.ideal_drive import IdealDrive
from tests.mapping.scenes import mount

SEEDS = (0, 4, 5)
SECONDS = 4.0
NOISE = parse_noise(json.dumps(IDEAL_CAMERA_NOISE), "the ideal camera")


@dataclass(frozen=True)
class Run:
    """A drive, its map, and what the mapper counted."""

    drive: IdealDrive
    map: ElevationMap
    counts: MapperCounts


def _run(drive: IdealDrive) -> Run:
    mapper = Mapper(MapSettings(), NOISE)
    mapper.add(mount())
    drive.open()
    for _ in range(drive.frames):
        for sample in drive.read(0.0):
            mapper.add(sample)
    mapper.finish()
    return Run(drive, mapper.elevation_map(), mapper.counts)


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    # Most of it is the tracing of rays, which lets other threads run.
    with ThreadPoolExecutor(2) as two_cores:
        return list(two_cores.map(lambda seed: _run(IdealDrive(seed, SECONDS)), SEEDS))


def _errors(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Return error and sigma of the confirmed cells, edges apart."""
    map_ = run.map
    truth = run.drive.terrain.height_m(map_.x_m[np.newaxis, :], map_.y_m[:, np.newaxis])
    counted = np.isin(map_.state, CONFIRMED) & ~edge_cells(truth, 1.2 * map_.resolution_m)
    error = map_.elevation_m.astype(np.float64) - truth
    return error[counted], map_.sigma_m[counted].astype(np.float64)


def _pooled(runs: list[Run]) -> Accuracy:
    errors, sigmas = zip(*map(_errors, runs), strict=True)
    return accuracy(np.concatenate(errors), np.concatenate(sigmas))


def test_every_frame_and_every_reading_is_mapped(runs: list[Run]) -> None:
    for run in runs:
        assert run.counts.frames == 40
        assert run.counts.frames_without_pose == run.counts.poses_out_of_order == 0
        assert run.counts.readings_outside == 0
        assert run.counts.readings == pytest.approx(40 * 320 * 240, rel=0.1)


def test_heights_are_true_to_five_millimetres(runs: list[Run]) -> None:
    for run in runs:
        error, _ = _errors(run)
        assert error.size > 5000
        assert np.sqrt(np.mean(error**2)) <= 0.005
        assert abs(error.mean()) < 0.001


def test_sigma_covers_what_it_promises(runs: list[Run]) -> None:
    found = _pooled(runs)
    assert 0.60 <= found.coverage_1sigma <= 0.80
    assert found.coverage_3sigma >= 0.98
    assert 0.5 < found.anees < 1.5


def test_what_could_be_seen_is_in_the_map(runs: list[Run]) -> None:
    for run in runs:
        known = run.drive.truth(0.04, NOISE.range_min_m, NOISE.range_max_m)
        truth = Truth(known.x_m, known.y_m, known.height_m, known.visible)
        assert evaluate_truth(run.map, truth).completeness > 0.9


def test_a_second_drive_makes_the_same_map_to_the_bit() -> None:
    maps = [_run(IdealDrive(7, 0.3)).map for _ in range(2)]
    assert maps[0].sha256() == maps[1].sha256()


def test_frames_alone_make_no_map_and_poses_give_frames_their_place() -> None:
    """Half of the depth frames are held back until two poses later."""
    drive = IdealDrive(7, 0.3)
    drive.open()
    samples = [sample for _ in range(drive.frames) for sample in drive.read(0.0)]
    late = Mapper(MapSettings(), NOISE)
    late.add(mount())
    frames = [sample for sample in samples if isinstance(sample, DepthFrame)]
    for sample in samples:
        if not isinstance(sample, DepthFrame):
            late.add(sample)
    assert late.counts.frames == 0
    for frame in frames:
        late.add(frame)
    assert late.elevation_map().sha256() == _run(IdealDrive(7, 0.3)).map.sha256()
