"""Which pixels see the plate: depth gate, RANSAC plane, largest component, eroded rim."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians, sin

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from calibration_rigs.errors import RigError
from calibration_rigs.plate_rig.manifest import CellEntry, Rig
from calibration_rigs.plate_rig.plane import DisparityPlane, fit_plane, pixels_of

Float64Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

ERODE_PX = 4
# A plate that bends is still one plate: this far from its plane a pixel still belongs to it.
_PLATE_TOLERANCE_M = 0.04
# A station may be off by this share of its distance and is still found.
_GATE_SHARE = 0.08
_GATE_M = 0.05
_TRIALS = 300
_PIXELS_AT_LEAST = 400
_SEEN_SHARE = 0.3


@dataclass(frozen=True, slots=True)
class Segment:
    """The plate in the image.

    Attributes:
        whole: (height, width) pixels on the plate.
        inside: the same without its rim of ERODE_PX pixels, holes filled.
        eroded: those of `inside` that read.
        plane: through the eroded pixels.
        mean_m: (height, width) mean of each pixel's readings over the frames; 0 = none.
    """

    whole: BoolArray
    inside: BoolArray
    eroded: BoolArray
    plane: DisparityPlane
    mean_m: Float64Array


def mean_depth_m(depth_mm: NDArray[np.uint16]) -> tuple[Float64Array, Float64Array]:
    """Return the mean of each pixel's readings in metres (0 = none) and the share of frames read.

    Args:
        depth_mm: (frames, height, width); 0 = no return.
    """
    count = np.zeros(depth_mm.shape[1:], np.uint32)
    total = np.zeros(depth_mm.shape[1:], np.uint32)
    for frame in depth_mm:  # along whole images: five times faster than along the first axis
        count += frame > 0
        total += frame
    return 1e-3 * total / np.maximum(count, 1), count / len(depth_mm)


def find_plate(
    mean_m: Float64Array, seen: Float64Array, cell: CellEntry, rig: Rig, step_m: float
) -> Segment:
    """Return the pixels that see the plate, and its plane.

    Args:
        mean_m, seen: from `mean_depth_m`.
        cell: where the plate should be.
        rig: how large it is.
        step_m: depth step of the sensor at the plate's distance.

    Raises:
        RigError: there is nothing like a plate where the tape says; without the cell's name.
    """
    half = 0.5 * rig.plate_width_m * abs(sin(radians(cell.angle_deg)))
    margin = half + _GATE_M + _GATE_SHARE * cell.distance_m
    near, far = cell.distance_m - margin, cell.distance_m + margin
    gated = (seen >= _SEEN_SHARE) & (mean_m > max(near, 0.0)) & (mean_m < far)
    found = int(np.count_nonzero(gated))
    if found < _PIXELS_AT_LEAST:
        raise RigError(
            f"no plate: {found} pixels read between {max(near, 0.0):.2f} and {far:.2f} m, expected "
            f"at least {_PIXELS_AT_LEAST}; check that the plate stands at its station and that "
            "the tape is right"
        )
    tolerance_m = _PLATE_TOLERANCE_M + 2.0 * step_m
    plane = _ransac(gated, mean_m, tolerance_m)
    whole = _component(gated, mean_m, plane, tolerance_m)
    for _ in range(2):  # the plane of what belongs to the plate, and what belongs to that plane
        u, v = pixels_of(whole)
        plane = fit_plane(u, v, mean_m[whole])
        whole = _component(gated, mean_m, plane, tolerance_m)
    inside = _eroded(whole)
    eroded = inside & (mean_m > 0.0)
    if np.count_nonzero(eroded) < _PIXELS_AT_LEAST // 4:
        raise RigError(
            f"no plate: the largest flat piece has {np.count_nonzero(whole)} pixels and hardly "
            f"more than a rim of {ERODE_PX}; move the plate into view or take it nearer"
        )
    u, v = pixels_of(eroded)
    return Segment(whole, inside, eroded, fit_plane(u, v, mean_m[eroded]), mean_m)


def _ransac(gated: BoolArray, mean_m: Float64Array, tolerance_m: float) -> DisparityPlane:
    """Return the plane through three pixels that most others are near to."""
    random = np.random.default_rng(1)
    u, v = pixels_of(gated)
    some = random.permutation(u.size)[:4000]
    u, v, z = u[some], v[some], mean_m[gated][some]
    picks = random.integers(0, u.size, (_TRIALS, 3))
    rows = np.stack([u[picks], v[picks], np.ones(picks.shape)], axis=-1)
    good = np.abs(np.linalg.det(rows)) > 0.01 * u.size  # three pixels in line make no plane
    if not good.any():
        return fit_plane(u, v, z)
    planes = np.linalg.solve(rows[good], (1.0 / z[picks[good]])[..., np.newaxis])[..., 0]
    inverse = planes @ np.stack([u, v, np.ones_like(u)])
    near = np.abs(inverse * z - 1.0) * z < 0.5 * tolerance_m  # |Z - Z_plane|, to first order
    best = planes[int(np.argmax(np.count_nonzero(near, axis=1)))]
    return DisparityPlane(*map(float, best))


def _component(
    gated: BoolArray, mean_m: Float64Array, plane: DisparityPlane, tolerance_m: float
) -> BoolArray:
    """Return the largest connected piece of what is near the plane, small holes filled."""
    height, width = mean_m.shape
    v, u = np.ogrid[:height, :width]
    inverse = plane.inverse_z(u.astype(np.float64), v.astype(np.float64))
    near = gated & (np.abs(inverse * mean_m - 1.0) * mean_m < tolerance_m)
    labels, count = ndimage.label(near)
    if count == 0:
        raise RigError("no plate: nothing flat where it should be; check station and tape")
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    largest = labels == int(np.argmax(sizes))
    filled: BoolArray = ndimage.binary_fill_holes(largest)
    return filled & (mean_m > 0.0)


def _eroded(whole: BoolArray) -> BoolArray:
    """Take ERODE_PX off the rim; what lies at the border of the image counts as rim."""
    filled = ndimage.binary_fill_holes(whole)
    eroded: BoolArray = ndimage.binary_erosion(filled, np.ones((3, 3)), ERODE_PX)
    return eroded
