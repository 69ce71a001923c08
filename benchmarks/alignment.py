"""How well frames are aligned with the map, what that costs, and what it must leave alone.

    python benchmarks/alignment.py [--seconds S] [--json FILE]

Frames and true poses are those of simulated drives. "recovery": the map is built from true poses;
every fourth frame is aligned from priors that are off by 30 mm and 1.2 degrees (RMS of the vector)
by the default form, by the form of three (whose x, y and yaw are true) and, where it is installed,
by small_gicp's GICP on the same points. "perfect": priors without error, with the stated sigmas,
are aligned, fused, and the map is built from the result, so that every disturbance stays. "plane":
level ground without features. Time is CPU time of the thread, median over the frames.
"""

from __future__ import annotations

import sys
from pathlib import Path

# Python puts the script's own folder first, where this very file would hide the package `mapping`.
sys.path[0] = str(Path(__file__).resolve().parents[1])

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.messages.frames import BASE_FRAME, DEPTH_OPTICAL_FRAME
from benchmarks.drives import Drive, make_drive
from drivers.samples import DepthFrame
from mapping.alignment.frame_points import PointGrouper
from mapping.alignment.fusion import fuse_pose, moved, pose_difference
from mapping.alignment.scan_to_map import ScanAligner
from mapping.alignment.settings import AlignmentForm, AlignmentSettings
from mapping.calibration_file import parse_noise
from mapping.cells.grid import make_grid
from mapping.cells.update_constants import fusion_constants
from mapping.cells.update_kernels import fuse
from mapping.geometry import RigidTransform, UncertainPose
from mapping.kernel_cache import compile_kernels
from mapping.measurement import FrameReducer, View
from mapping.motion.ledger import at_rest
from mapping.mounts import MountTree
from mapping.settings import MapSettings
from simulation.devices.depth_camera import DepthCamera
from simulation.devices.kinect_noise import kinect_noise_file
from simulation.terrain.height_grid import HeightGrid

Float64Array = NDArray[np.float64]
Aligned = Callable[["Site", View], tuple[RigidTransform | None, float]]

_ERROR = np.array([0.03 / np.sqrt(3.0)] * 3 + [np.radians(1.2) / np.sqrt(3.0)] * 3)
_LEVEL = np.array([0.0, 0.0, 1.0, 1.0, 1.0, 0.0])
_FIRST_FRAME, _EVERY = 15, 4


@dataclass(frozen=True, slots=True)
class Row:
    """One line: position in mm, angle in degrees; of the pose's error, RMS and largest."""

    what: str
    ground: str
    how: str
    frames: int
    rms_mm: float
    max_mm: float
    rms_deg: float
    max_deg: float
    align_ms: float
    map_ms: float


class Site:
    """A map in the making, and the frames of a drive."""

    def __init__(self, drive: Drive, settings: AlignmentSettings) -> None:
        mounts = MountTree()
        mounts.add(drive.mounts.transforms)
        self.mount = mounts.lookup(BASE_FRAME, DEPTH_OPTICAL_FRAME)
        self.frames = [sample for sample in drive.samples if isinstance(sample, DepthFrame)]
        self.true_pose = drive.true_pose
        self.settings = settings
        self.map_settings = MapSettings()
        model = drive.scenario.camera.model
        noise = parse_noise(json.dumps(kinect_noise_file(model)), "simulation")
        self.reducer = FrameReducer(self.frames[0].camera, noise, self.map_settings)
        self.grid = make_grid(self.map_settings)
        self.aligner = ScanAligner(settings, self.map_settings.resolution_m)
        self.map_ms: list[float] = []
        self._fusion = fusion_constants(self.map_settings)

    def view(self, t_ns: int, pose: RigidTransform, covariance: Float64Array) -> View:
        """Return the camera's view from a pose of the rover."""
        return View(UncertainPose(t_ns, pose, covariance), pose @ self.mount)

    def add(self, view: View) -> None:
        """Map the loaded frame."""
        start = time.thread_time()
        place = view.body.transform.translation_m
        window = self.grid.prepare(self.reducer.footprint(view), float(place[0]), float(place[1]))
        sums, _ = self.reducer.reduce(view, window)
        constants = self.reducer.frame_constants(view, window, self.grid.position(window))
        fuse(sums, constants, self._fusion, self.grid.layers, at_rest())
        self.map_ms.append(1e3 * (time.thread_time() - start))


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=50.0, help="length of each drive")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    compile_kernels()
    rows: list[Row] = []
    _print_head()
    for ground in ("rough", "simulation", "smooth"):
        drive = make_drive(ground, 1, options.seconds)
        rows += [_show(row) for row in recovery(drive)]
        for sigma_m, sigma_deg in ((0.001, 0.03), (0.03, 1.2)):
            rows.append(_show(perfect(drive, sigma_m, sigma_deg)))
        if ground == "smooth":
            rows.append(_show(plane(drive)))
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=2) + "\n")


def recovery(drive: Drive) -> list[Row]:
    """Return how far from the truth the ways to align end."""
    rows = [
        _recovery(drive, "6-dof", _ERROR, _by_map, "point to plane, 6"),
        _recovery(drive, "z-roll-pitch", _ERROR * _LEVEL, _by_map, "point to plane, 3"),
    ]
    try:
        import small_gicp  # noqa: F401 - is it there?
    except ImportError:
        return rows
    return [*rows, _recovery(drive, "6-dof", _ERROR, _by_gicp, "small_gicp, GICP")]


def _recovery(
    drive: Drive, form: AlignmentForm, sigma: Float64Array, aligned: Aligned, how: str
) -> Row:
    site = Site(drive, AlignmentSettings(form=form))
    random = np.random.default_rng(0)
    errors: list[Float64Array] = []
    times: list[float] = []
    for index, frame in enumerate(site.frames[:200]):
        truth = site.true_pose(frame.t_ns)
        site.reducer.load(frame.depth_mm)
        if index >= _FIRST_FRAME and index % _EVERY == 0:
            prior = moved(truth, sigma * random.standard_normal(6))
            found, taken_ms = aligned(site, site.view(frame.t_ns, prior, np.zeros((6, 6))))
            times.append(taken_ms)
            errors.append(pose_difference(prior if found is None else found, truth))
        site.add(site.view(frame.t_ns, truth, np.zeros((6, 6))))
    return _row("recovery", drive.name, how, errors, times, site.map_ms)


def _by_map(site: Site, view: View) -> tuple[RigidTransform | None, float]:
    start = time.thread_time()
    found = site.aligner.align(site.reducer, view, site.grid)
    return found.pose.transform if found else None, 1e3 * (time.thread_time() - start)


def _by_gicp(site: Site, view: View) -> tuple[RigidTransform | None, float]:
    """Align the frame's points with the cells of the map by small_gicp."""
    import small_gicp

    start = time.thread_time()
    window = site.reducer.footprint(view).intersection(site.grid.extent)
    cell_m = site.map_settings.resolution_m
    body = view.body.transform.translation_m
    grouper = PointGrouper(cell_m, site.settings.fewest_pixels)
    source = grouper.group(site.reducer, view, window).values[:, :3].copy()
    row, column = site.grid.position(window)
    part = np.s_[row : row + window.cells_y, column : column + window.cells_x]
    layers = site.grid.layers
    rows, columns = np.nonzero(layers.pixels[part] >= site.settings.fewest_pixels)
    cells = np.column_stack([window.first_x + columns, window.first_y + rows]) + 0.5
    target = np.column_stack([cells * cell_m, layers.elevation_m[part][rows, columns]]) - body
    found = small_gicp.align(
        target,
        source,
        registration_type="GICP",
        downsampling_resolution=cell_m,
        max_correspondence_distance=0.15,
        max_iterations=30,
        rotation_epsilon=1e-5,
        translation_epsilon=1e-5,
    ).T_target_source
    rotation = found[:3, :3] @ view.body.transform.rotation
    pose = RigidTransform(rotation, body + found[:3, 3])
    return pose, 1e3 * (time.thread_time() - start)


def perfect(drive: Drive, sigma_m: float, sigma_deg: float, what: str = "perfect") -> Row:
    """Return by how much priors without error are disturbed, the map being built from them."""
    site = Site(drive, AlignmentSettings())
    covariance = np.diag([sigma_m**2] * 3 + [np.radians(sigma_deg) ** 2] * 3)
    errors: list[Float64Array] = []
    times: list[float] = []
    for frame in site.frames:
        truth = site.true_pose(frame.t_ns)
        site.reducer.load(frame.depth_mm)
        prior = site.view(frame.t_ns, truth, covariance)
        start = time.thread_time()
        found = site.aligner.align(site.reducer, prior, site.grid)
        pose = fuse_pose(prior.body, found, site.settings) if found else prior.body
        times.append(1e3 * (time.thread_time() - start))
        errors.append(pose_difference(pose.transform, truth))
        site.add(site.view(frame.t_ns, pose.transform, np.zeros((6, 6))))
    return _row(
        what, drive.name, f"{1e3 * sigma_m:g} mm, {sigma_deg:g} deg", errors, times, site.map_ms
    )


def plane(drive: Drive) -> Row:
    """Return by how much x, y and yaw are moved on level ground, from priors that are off."""
    flat = HeightGrid(-8.0, -8.0, 0.02, np.zeros((800, 800), np.float32))
    kinect = drive.scenario.camera
    camera = DepthCamera(flat, kinect.camera, kinect.model, 1)
    site = Site(drive, AlignmentSettings())
    random = np.random.default_rng(0)
    errors: list[Float64Array] = []
    times: list[float] = []
    for index in range(60):
        step = np.array([0.03 * index, 0.0, 0.0, 0.02 * np.sin(index), 0.0, 0.01 * index])
        truth = moved(RigidTransform.identity(), step)
        eye = truth @ site.mount
        frame = camera.frame(camera.look(eye.translation_m, eye.rotation), index, index)
        site.reducer.load(frame.depth_mm)
        if index >= _FIRST_FRAME:
            prior = moved(truth, _ERROR * random.standard_normal(6))
            found, taken_ms = _by_map(site, site.view(index, prior, np.zeros((6, 6))))
            times.append(taken_ms)
            change = pose_difference(prior if found is None else found, prior)
            errors.append(change * (1.0 - _LEVEL))
        site.add(site.view(index, truth, np.zeros((6, 6))))
    return _row("x, y, yaw", "plane", "point to plane, 6", errors, times, site.map_ms)


def _row(
    what: str,
    ground: str,
    how: str,
    errors: list[Float64Array],
    times: list[float],
    map_ms: list[float],
) -> Row:
    shift = 1e3 * np.linalg.norm(np.array(errors)[:, :3], axis=1)
    turn = np.degrees(np.linalg.norm(np.array(errors)[:, 3:], axis=1))
    return Row(
        what=what,
        ground=ground,
        how=how,
        frames=len(errors),
        rms_mm=float(np.sqrt(np.mean(shift**2))),
        max_mm=float(shift.max()),
        rms_deg=float(np.sqrt(np.mean(turn**2))),
        max_deg=float(turn.max()),
        align_ms=float(np.median(times)),
        map_ms=float(np.median(map_ms)),
    )


def _print_head() -> None:
    print(
        f"{'':>10} {'ground':>10} {'how':>18} {'frames':>6} {'RMS mm':>7} {'max mm':>7} "
        f"{'RMS deg':>8} {'max deg':>8} {'align ms':>8} {'map ms':>7}"
    )


def _show(r: Row) -> Row:
    print(
        f"{r.what:>10} {r.ground:>10} {r.how:>18} {r.frames:>6} {r.rms_mm:>7.2f} {r.max_mm:>7.2f} "
        f"{r.rms_deg:>8.3f} {r.max_deg:>8.3f} {r.align_ms:>8.2f} {r.map_ms:>7.2f}",
        flush=True,
    )
    return r


if __name__ == "__main__":
    main()
