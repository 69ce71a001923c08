"""All cells of a rig: read, analyse, fit, judge."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from hashlib import sha256
from math import inf

import numpy as np
from numpy.typing import NDArray

from calibration_rigs.errors import RigError
from calibration_rigs.plate_rig.bands import BOOTSTRAPS, Bands, bootstrap
from calibration_rigs.plate_rig.bias import BiasFit, fit_bias, tape_outliers
from calibration_rigs.plate_rig.cell import CellOutcome, analyse
from calibration_rigs.plate_rig.cell_result import CellResult
from calibration_rigs.plate_rig.faults import Fault
from calibration_rigs.plate_rig.frames import read_frames
from calibration_rigs.plate_rig.manifest import CellEntry, Manifest
from calibration_rigs.plate_rig.sigma_models import SigmaFit, cell_sigmas, fit_laws
from drivers.errors import TerravibeError
from mapping.calibration_file import DeviceIdentity

Float64Array = NDArray[np.float64]

_CELLS_AT_LEAST = 3
# Read by the library once, when numpy is first imported.
_BLAS_THREADS = "OPENBLAS_NUM_THREADS"
_BAND_ANGLES_DEG = (0.0, 30.0, 60.0, 75.0)


@dataclass(frozen=True, slots=True)
class CellFailure:
    """A cell that could not be analysed at all, and why."""

    cell: CellEntry
    reason: str


@dataclass(frozen=True, slots=True)
class Distortion:
    """Mean disparity minus the plane's, over all cells, per pixel.

    Attributes:
        mean_px: (height, width) pixels of the 640 px wide image; NaN where no plate was.
        cells: (height, width) how many cells saw the plate there.
    """

    mean_px: Float64Array
    cells: NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class PlateResult:
    """Everything that the rig came to.

    Attributes:
        manifest: what was asked for.
        cells: results, in the manifest's order.
        failures: cells without result.
        laws: fits of sigma(z, theta), the best first; the first has a covariance.
        bands: of the first.
        bias: fit of bias(Z).
        lateral: l0 and l1 of l0 + l1 t, pixels of the 640 px wide image.
        distortion: of the sensor, from the cells that are used.
        device: who was measured.
        sha256: of all recordings, in order.
    """

    manifest: Manifest
    cells: tuple[CellResult, ...]
    failures: tuple[CellFailure, ...]
    laws: tuple[SigmaFit, ...]
    bands: Bands
    bias: BiasFit
    lateral: tuple[float, float]
    distortion: Distortion
    device: DeviceIdentity
    sha256: str

    @property
    def used(self) -> list[CellResult]:
        """The cells that take part in the fits."""
        return [cell for cell in self.cells if cell.is_used]


def process(
    manifest: Manifest,
    progress: Callable[[str], None] = lambda _: None,
    workers: int = 1,
    bootstraps: int = BOOTSTRAPS,
) -> PlateResult:
    """Return what a rig's recordings come to; one cell a worker is in memory at a time.

    Args:
        manifest: the cells.
        progress: told what has been reached.
        workers: processes; 1 = this one.
        bootstraps: fits that the bands are made of.

    Raises:
        RigError: fewer than three cells can be used, or they are of several devices.
    """
    results: list[CellResult] = []
    failures: list[CellFailure] = []
    distortion = _DistortionSum()
    for number, outcome in enumerate(_outcomes(manifest, workers), 1):
        progress(f"cell {number} of {len(manifest.cells)}, {manifest.cells[number - 1].name}")
        if isinstance(outcome, CellFailure):
            failures.append(outcome)
            continue
        results.append(outcome.result)
        _one_device(results)
        distortion.add(outcome)
    results = _with_tape_outliers(results)
    used = [cell for cell in results if cell.is_used]
    if len(used) < _CELLS_AT_LEAST:
        raise RigError(_too_few(results, failures))
    progress("fitting")
    sigmas = cell_sigmas(used)
    laws = fit_laws(sigmas)
    if not laws:
        raise RigError(
            "in every cell the steps hide the noise; record a nearer station or steeper angles"
        )
    z_m = np.linspace(sigmas.at.z_m.min(), sigmas.at.z_m.max(), 60)
    best, bands = bootstrap(laws[0], sigmas, z_m, np.radians(_BAND_ANGLES_DEG), bootstraps)
    return PlateResult(
        manifest=manifest,
        cells=tuple(results),
        failures=tuple(failures),
        laws=(best, *laws[1:]),
        bands=bands,
        bias=fit_bias(used, manifest.rig),
        lateral=_lateral(used),
        distortion=distortion.mean(),
        device=_one_device(results),
        sha256=sha256("".join(cell.sha256 for cell in results).encode()).hexdigest(),
    )


class _DistortionSum:
    """Adds up the residuals of the cells that are used."""

    def __init__(self) -> None:
        self._total: Float64Array = np.zeros((0, 0))
        self._cells: NDArray[np.uint16] = np.zeros((0, 0), np.uint16)

    def add(self, outcome: CellOutcome) -> None:
        """Add a cell; images of all cells have one size."""
        if not outcome.result.is_used:
            return
        if not self._total.size:
            self._total = np.zeros(outcome.residual_px.shape)
            self._cells = np.zeros(outcome.residual_px.shape, np.uint16)
        there = np.isfinite(outcome.residual_px)
        self._total[there] += outcome.residual_px[there]
        self._cells[there] += np.uint16(1)

    def mean(self) -> Distortion:
        """Return the mean; NaN where no cell was."""
        mean = np.where(self._cells > 0, self._total / np.maximum(self._cells, 1), np.nan)
        return Distortion(mean, self._cells)


def _outcomes(manifest: Manifest, workers: int) -> Iterator[CellOutcome | CellFailure]:
    """Give each cell's outcome, in order."""
    jobs = [(manifest, cell) for cell in manifest.cells]
    if min(workers, len(jobs)) < 2:
        yield from map(_one, jobs)
        return
    # A fresh interpreter each: a fork would copy the threads' locks.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        with _one_thread_each():
            outcomes = pool.map(_one, jobs)
        yield from outcomes


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Tell processes that start meanwhile to leave the other cores to each other.

    The linear algebra's threads wait by spinning: a fifth of the processor time of all cells.
    """
    before = os.environ.get(_BLAS_THREADS)
    os.environ[_BLAS_THREADS] = before or "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[_BLAS_THREADS]


def _one(job: tuple[Manifest, CellEntry]) -> CellOutcome | CellFailure:
    manifest, cell = job
    try:
        frames = read_frames(manifest.folder / cell.recording, manifest.rig)
        return analyse(frames, cell, manifest.rig)
    except TerravibeError as error:
        return CellFailure(cell, str(error))


def _one_device(cells: list[CellResult]) -> DeviceIdentity:
    """Return the device of all cells.

    Raises:
        RigError: there are several, or several image sizes or intrinsics.
    """
    devices = {(cell.device.model, cell.device.serial): cell for cell in cells}
    if len(devices) > 1:
        names = "; ".join(
            f"{model or 'unknown'} {serial or 'without serial number'} in {cell.cell.recording}"
            for (model, serial), cell in devices.items()
        )
        raise RigError(f"the recordings are of {len(devices)} devices: {names}; calibrate each")
    if len({cell.camera for cell in cells}) > 1:
        raise RigError("the recordings differ in image size or intrinsics; expected one camera")
    return cells[0].device if cells else DeviceIdentity()


def _with_tape_outliers(cells: list[CellResult]) -> list[CellResult]:
    """Return the cells with those named whose tape is off by decimetres."""
    found = list(cells)
    for k in tape_outliers(cells):
        error = cells[k].error_m or 0.0
        text = (
            f"tape and plate disagree by {error:+.3f} m, unlike all others; measure the station "
            "again, or correct the number"
        )
        fault = Fault("tape", text, excludes=True)
        found[k] = replace(
            cells[k], error_m=None, z_accuracy=None, faults=(*cells[k].faults, fault)
        )
    return found


def _too_few(cells: list[CellResult], failures: list[CellFailure]) -> str:
    reasons = [f"{failure.cell.name}: {failure.reason}" for failure in failures]
    reasons += [
        f"{cell.cell.name}: {fault.text}"
        for cell in cells
        for fault in cell.faults
        if fault.excludes
    ]
    usable = sum(cell.is_used for cell in cells)
    return (
        f"{usable} of {len(cells) + len(failures)} cells can be used, expected at least "
        f"{_CELLS_AT_LEAST}; {'; '.join(reasons[:3]) or 'record more'}"
    )


def _lateral(cells: list[CellResult]) -> tuple[float, float]:
    """Return l0, l1 of the edges' spread over t, by least squares weighted with readings."""
    seen = [cell for cell in cells if cell.lateral_readings > 0]
    if not seen:
        return 0.0, 0.0
    theta = np.array([cell.incidence_rad for cell in seen])
    ratio = theta / (np.pi / 2.0 - theta)
    sigma = np.array([cell.lateral_px for cell in seen])
    root = np.sqrt([cell.lateral_readings for cell in seen])
    columns = np.column_stack([np.ones_like(ratio), ratio]) * root[:, np.newaxis]
    l0, l1 = np.linalg.lstsq(columns, sigma * root, rcond=None)[0]
    if l1 < 0.0 or np.ptp(ratio) == 0.0:
        return float(np.average(sigma, weights=root**2)), 0.0
    if l0 < 0.0:
        return 0.0, float(np.average(sigma / np.maximum(ratio, 1e-3), weights=(root * ratio) ** 2))
    return float(l0), float(l1)


def worst_held_out(result: PlateResult) -> float:
    """Return how far the best law misses a station it has not seen, as a share."""
    share = result.laws[0].held_out
    return float(np.expm1(share)) if share < inf else inf
