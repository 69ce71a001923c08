"""Cells for `plate_rig.py`: a plate before a simulated Kinect, and recordings of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from acquisition.importing import record_all
from calibration_rigs.plate_rig.manifest import CellEntry, Manifest, Rig
from simulation.devices.kinect import KinectModel, kinect_640
from tests.fakes.plate_rig import Plate, PlateCamera, frames_of

Float64Array = NDArray[np.float64]

DEVICES = {
    "kinect": KinectModel(disparity_bias_px=0.05),
    "quiet": KinectModel(disparity_bias_px=0.05, sigma_disparity_px=0.02, floor_sigma_m=2e-4),
}


def recorded(
    folder: Path,
    model: KinectModel,
    frames: int,
    stations_m: Sequence[float],
    angles_deg: Sequence[float],
    blur_px: float = 0.0,
) -> Manifest:
    """Record what is not there yet."""
    folder.mkdir(exist_ok=True)
    random = np.random.default_rng(4)
    cells = []
    for z_m in stations_m:
        for angle in angles_deg:
            plate = Plate(z_m, angle)
            path = folder / f"z{10 * z_m:.0f}_a{angle:.0f}.mcap"
            cells.append(
                CellEntry(
                    recording=path.name,
                    distance_m=z_m,
                    angle_deg=angle,
                    corners_m=plate.corners_m(random),
                    lux=300.0,
                    temperature_c=21.0,
                )
            )
            if not path.exists():
                camera = PlateCamera(seen(plate, frames, model, blur_px), kinect_640())
                record_all(camera, path, static_transforms=[], settings={})
    return Manifest(folder, Rig(), tuple(cells))


def seen(plate: Plate, count: int, model: KinectModel, blur_px: float) -> NDArray[np.uint16]:
    """Return frames of a plate; blurred noise if asked for, else the simulated Kinect's own."""
    if not blur_px:
        return frames_of(plate, count, 7, model)
    random = np.random.default_rng([7, round(1000 * plate.z_m), round(plate.angle_deg)])
    view = plate.view(kinect_640())
    return np.stack([shared_noise(view.z_m, model, blur_px, random) for _ in range(count)])


def shared_noise(
    z_m: Float64Array, model: KinectModel, blur_px: float, random: np.random.Generator
) -> NDArray[np.uint16]:
    """Return a Kinect's readings whose disparity noise is alike over 4 pi blur^2 pixels."""
    there = z_m > 0.0
    z = np.where(there, z_m, 1.0)
    noise = gaussian_filter(random.standard_normal(z.shape), blur_px)
    noise *= model.sigma_disparity_px / noise.std()
    disparity = model.disparity_px_m / z + model.disparity_bias_px + noise
    steps = np.maximum(np.rint(disparity / model.disparity_step_px), 1.0)
    reading = model.disparity_px_m / (steps * model.disparity_step_px)
    reading += model.floor_sigma_m * random.standard_normal(z.shape)
    inside = there & (reading >= model.range_min_m) & (reading <= model.range_max_m)
    return np.where(inside, np.rint(1e3 * reading), 0.0).astype(np.uint16)
