"""The plate rig against what is true: a simulated Kinect, 11 stations x 6 angles, 100 frames.

    python benchmarks/plate_rig.py rig --folder DIR [--frames N] [--json FILE]
    python benchmarks/plate_rig.py coverage [--repeats N] [--json FILE]
    python benchmarks/plate_rig.py column [--json FILE]
    python benchmarks/plate_rig.py mapping --folder DIR [--json FILE]

rig: records the cells into DIR (unless they are there), calibrates, and compares every cell's
sigma, the law and the bias with the model's own. coverage: how often the 95 % interval holds the
truth, on a cut-out of the image. column: the paper's column estimate beside the spread of a
pixel, with white noise and with noise that pixels share. mapping: a device whose noise is twice
Nguyen's, mapped with the default model and with its own calibration.
"""

from __future__ import annotations

import sys
from pathlib import Path

# Python puts the script's own folder first, where mapping.py would hide the package `mapping`.
sys.path[0] = str(Path(__file__).resolve().parents[1])

import argparse
import json
import resource
import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from benchmarks.plate_cells import DEVICES, recorded, seen, shared_noise
from calibration_rigs.plate_rig.cell import analyse
from calibration_rigs.plate_rig.cell_result import CellResult
from calibration_rigs.plate_rig.frames import CellFrames
from calibration_rigs.plate_rig.manifest import CellEntry, Rig
from calibration_rigs.plate_rig.process import process
from calibration_rigs.plate_rig.products import noise_model
from calibration_rigs.plate_rig.report import write_products
from drivers.samples import DepthFrame
from mapping.calibration_file import DeviceIdentity
from mapping.cells.elevation_map import CellState
from mapping.mapper import Mapper
from mapping.noise import KINECT_V1, NGUYEN_2012, DepthNoiseModel
from mapping.settings import MapSettings
from simulation.devices.kinect import (
    KinectModel,
    kinect_640,
)
from tests.fakes.plate_rig import (
    ANGLES_DEG,
    STATIONS_M,
    Plate,
    cropped,
    frames_of,
    true_bias_m,
    true_sigma_m,
)
from tests.mapping.scenes import looking, mount, plane_z, pose_sample

Float64Array = NDArray[np.float64]

_TOLD = 0.3
_RUNS = 8


def main() -> None:
    """Run one of the measurements."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("rig", "coverage", "column", "mapping"))
    parser.add_argument("--device", choices=tuple(DEVICES), default="kinect")
    parser.add_argument("--folder", type=Path, default=Path("plate_rig"))
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    rows = {"rig": rig, "coverage": coverage, "column": column, "mapping": mapping}[options.what](
        options
    )
    if options.json:
        options.json.write_text(json.dumps(rows, indent=2) + "\n")


def rig(options: argparse.Namespace) -> object:
    """Calibrate the whole rig and compare with the truth."""
    model = DEVICES[options.device]
    manifest = recorded(options.folder, model, options.frames, STATIONS_M, ANGLES_DEG)
    before_s = time.monotonic()
    result = process(manifest, workers=options.workers)
    took_s = time.monotonic() - before_s
    used_s = sum(
        resource.getrusage(who).ru_utime + resource.getrusage(who).ru_stime
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    peak_mb = max(
        resource.getrusage(who).ru_maxrss / 1024
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    write_products(result, options.folder, undistortion=True)
    ratios, law_ratios, wrong, inside = [], [], 0, 0
    noise = noise_model(result)
    for cell in result.cells:
        true_m = true_sigma_m(model, cell.z_m, cell.incidence_rad)
        told = true_m / cell.step_m >= _TOLD
        wrong += told == cell.spread.is_below
        if told and not cell.spread.is_below:
            ratios.append(cell.sigma_m / true_m)
            inside += cell.spread.low * cell.step_m <= true_m <= cell.spread.high * cell.step_m
            total_m = np.hypot(true_m, cell.step_m / np.sqrt(12.0))
            law_m = noise.axial_sigma_m(np.array(cell.z_m), np.array(cell.incidence_rad))
            law_ratios.append(float(law_m / total_m))
    z = np.array(STATIONS_M)
    bias_off_mm = 1e3 * (result.bias.at_m(z) - [true_bias_m(model, value) for value in z])
    row = {
        "device": options.device,
        "cells": len(result.cells),
        "used": len(result.used),
        "law": result.laws[0].name,
        "worst_cell": float(np.abs(np.array(ratios) - 1.0).max()),
        "worst_law": float(np.abs(np.array(law_ratios) - 1.0).max()),
        "told": len(ratios),
        "inside_interval": inside,
        "told_or_below_wrongly": wrong,
        "worst_bias_mm": float(np.abs(bias_off_mm).max()),
        "wall_s": took_s,
        "cpu_s": used_s,
        "peak_mb_of_a_process": peak_mb,
        "frames": sum(cell.frames for cell in result.cells),
    }
    for name, value in row.items():
        print(f"{name:>24} {value:.4g}" if isinstance(value, float) else f"{name:>24} {value}")
    return row


def coverage(options: argparse.Namespace) -> object:
    """Count how often the interval of sigma holds the truth, beside what 95 % would give."""
    camera = cropped(kinect_640(), slice(180, 276), slice(272, 368))
    rig_ = Rig(baseline_m=Rig().baseline_m * camera.width_px / 640)
    model = DEVICES["kinect"]
    rows = []
    n = options.repeats
    print(f"{'cell':>16} {'sigma/q':>8} {'inside':>7} {'mean ratio':>11} {'chi2 fails':>11}")
    for z_m, angle in ((1.0, 0.0), (1.4, 0.0), (1.4, 60.0), (2.2, 30.0), (3.0, 0.0)):
        inside, ratios, fails = 0, [], 0
        for seed in range(n):
            frames = CellFrames(
                frames_of(Plate(z_m, angle), 10, seed, model, camera), camera, DeviceIdentity(), ""
            )
            entry = CellEntry(recording="x", distance_m=z_m, angle_deg=angle)
            cell = analyse(frames, entry, rig_).result
            true_m = true_sigma_m(model, cell.z_m, cell.incidence_rad)
            inside += cell.spread.low * cell.step_m <= true_m <= cell.spread.high * cell.step_m
            ratios.append(cell.sigma_m / true_m)
            fails += cell.goodness is not None and cell.goodness.p < 0.05
        rows.append([z_m, angle, inside / n, float(np.mean(ratios)), fails / n])
        print(
            f"{z_m:.1f} m / {angle:2.0f} deg   {cell.spread.sigma:8.2f} {100 * inside / n:6.1f}% "
            f"{np.mean(ratios):11.4f} {100 * fails / n:10.1f}%",
            flush=True,
        )
    whole = float(np.mean([row[2] for row in rows]))
    places, all_ = _band(n), _band(n * len(rows))
    print(
        f"a place, {n} intervals: 95 % gives {100 * places[0]:.1f} to {100 * places[1]:.1f} %\n"
        f"pooled, {n * len(rows)}: {100 * whole:.2f} %; 95 % gives {100 * all_[0]:.1f} to "
        f"{100 * all_[1]:.1f} %"
    )
    return {"cells": rows, "all": whole, "band_of_a_place": places, "band_of_all": all_}


def _band(trials: int) -> tuple[float, float]:
    """Return the shares between which 95 of 100 counts lie when each trial has 95 %."""
    low, high = (float(binom.ppf(p, trials, 0.95)) / trials for p in (0.025, 0.975))
    return low, high


def column(options: argparse.Namespace) -> object:
    """Compare the paper's column estimate with the spread of a pixel, at 3 m."""
    del options
    rows = []
    print(f"{'noise':>12} {'pixel':>9} {'column SD':>10} {'too small':>10} {'rows':>6} {'sqrt':>6}")
    for name, blur_px in (("white", 0.0), ("shared 2 px", 0.6), ("shared 6 px", 1.1)):
        cell = _shared_noise_cell(blur_px)
        pixel_mm, column_mm = 1e3 * cell.plain_sigma_m, 1e3 * cell.paper.column_sigma_m
        rows.append([name, pixel_mm, column_mm, pixel_mm / column_mm, cell.correlation_area_px])
        print(
            f"{name:>12} {pixel_mm:6.2f} mm {column_mm:7.2f} mm {pixel_mm / column_mm:9.1f}x "
            f"{cell.paper.rows:6.0f} {np.sqrt(cell.paper.rows):6.1f}  area "
            f"{cell.correlation_area_px:.1f} px, sigma {1e3 * cell.sigma_m:.2f} mm"
        )
    return rows


def _shared_noise_cell(blur_px: float) -> CellResult:
    """Return a cell at 3 m whose disparity noise is the Kinect's, shared by neighbours."""
    frames = seen(Plate(3.0, 15.0), 20, KinectModel(floor_sigma_m=0.0), blur_px)
    cell = CellEntry(recording="x", distance_m=3.0, angle_deg=15.0)
    return analyse(CellFrames(frames, kinect_640(), DeviceIdentity(), ""), cell, Rig()).result


def mapping(options: argparse.Namespace) -> object:
    """Map a floor with a device that is twice as noisy as Nguyen's, with several models."""
    device = replace(DEVICES["kinect"], sigma_disparity_px=0.13, floor_sigma_m=0.002)
    stations_m = (1.0, 1.4, 1.8, 2.2, 2.6, 3.0)
    rows = []
    print(
        f"{'device':>12} {'model':>12} {'1 sigma':>8} {'3 sigma':>8} {'ANEES':>7} {'rmse':>9} "
        f"{'bias':>9}"
    )
    for kind, blur_px in (("shared 2 px", 0.4), ("shared 42 px", 1.83)):
        folder = options.folder / kind.replace(" ", "_")
        folder.mkdir(parents=True, exist_ok=True)
        manifest = recorded(folder, device, 12, stations_m, (0.0, 30.0, 60.0), blur_px)
        own = noise_model(process(manifest))
        for name, noise in (("nguyen2012", NGUYEN_2012), ("kinect-v1", KINECT_V1), ("own", own)):
            zero_m = manifest.rig.tape_zero_sigma_m if name == "own" else 0.0
            errors, sigmas = _floor_errors(device, noise, blur_px, zero_m)
            score = errors / sigmas
            row = [
                kind,
                name,
                float(np.mean(np.abs(score) < 1.0)),
                float(np.mean(np.abs(score) < 3.0)),
                float(np.mean(score**2)),
                1e3 * float(np.sqrt(np.mean(errors**2))),
                1e3 * float(np.mean(errors)),
            ]
            rows.append(row)
            print(
                f"{kind:>12} {name:>12} {row[2]:8.1%} {row[3]:8.2%} {row[4]:7.2f} {row[5]:6.2f} mm "
                f"{row[6]:6.2f} mm",
                flush=True,
            )
    return rows


def _floor_errors(
    device: KinectModel, noise: DepthNoiseModel, blur_px: float, zero_sigma_m: float
) -> tuple[Float64Array, Float64Array]:
    """Return error and sigma of the confirmed cells of short runs over a flat floor.

    The zero of a rig's tape is a draw of its own in every run: a calibration says how well it
    knows that, and one rig alone cannot show whether it is right.
    """
    camera = kinect_640()
    errors, sigmas = [], []
    for seed in range(_RUNS):
        random = np.random.default_rng(seed)
        settings = MapSettings(resolution_m=0.04, range_min_m=1.0, range_max_m=2.98)
        zero_m = zero_sigma_m * random.standard_normal()
        mapper = Mapper(settings, replace(noise, bias_m=noise.bias_m + zero_m))
        mapper.add(mount())
        for k in range(6):
            rotation = looking(10.0 * k, 30.0)
            z_m = plane_z(camera, rotation, (0.0, 0.0, 1.0), -0.8)
            depth = shared_noise(z_m, device, blur_px, random)
            mapper.add(pose_sample(k * 10**8, (0.05 * k, 0.0, 0.8), rotation))
            mapper.add(DepthFrame(k * 10**8, depth, camera, k))
        map_ = mapper.elevation_map()
        good = map_.state >= CellState.MEASURED
        errors.append(map_.elevation_m[good].astype(np.float64))
        sigmas.append(np.sqrt(map_.variance_m2[good].astype(np.float64)))
    return np.concatenate(errors), np.concatenate(sigmas)


if __name__ == "__main__":
    main()
