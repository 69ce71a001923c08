"""What is said of depth cameras: fill rate, accuracy, spreads in time and across the plate.

The names and definitions are those of the depth-quality tools of camera makers: fill rate, the
share of the plate's pixels that read; Z-accuracy, the median of (reading - truth) / truth; plane
RMS, the deviation from the plane in millimetres; subpixel RMS, the same as disparity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration_rigs.plate_rig.outline import Edge, Outline
from calibration_rigs.plate_rig.plane import DisparityPlane

Float64Array = NDArray[np.float64]
DepthStack = NDArray[np.uint16]

_GRID = 5
_EDGE_FRAMES = 20
# A pixel with a reading this far from the plane is not on the plate.
_ON_PLATE = 0.03
_STRAY_PX = 4.0


@dataclass(frozen=True, slots=True)
class TemporalSpread:
    """How much each pixel changes from frame to frame.

    Attributes:
        median_m: median over the pixels of their standard deviation over the frames.
        still_share: pixels that never change.
    """

    median_m: float
    still_share: float


def temporal_spread(depth_mm: DepthStack, mask: NDArray[np.bool_]) -> TemporalSpread:
    """Return the spread over the frames of the pixels of a mask that read at least twice.

    Args:
        depth_mm: (frames, height, width); 0 = no return.
        mask: (height, width).
    """
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    count = np.zeros(mask[box].shape, np.uint32)
    total = np.zeros(count.shape, np.uint64)
    squares = np.zeros(count.shape, np.uint64)
    for frame in depth_mm[(slice(None), *box)]:
        reading = frame.astype(np.uint32)
        count += reading > 0
        total += reading
        squares += reading * reading
    often = mask[box] & (count > 1)
    if not often.any():
        return TemporalSpread(0.0, 0.0)
    n = count[often].astype(np.float64)
    scatter = squares[often] - total[often].astype(np.float64) ** 2 / n
    sigma_mm = np.sqrt(np.maximum(scatter, 0.0) / (n - 1.0))
    still = scatter < 0.5 / n  # integers: exactly 0, but for the last bit of the division
    return TemporalSpread(1e-3 * float(np.median(sigma_mm)), float(np.mean(still)))


@dataclass(frozen=True, slots=True)
class PaperNumbers:
    """The paper's own procedure, beside ours; not to be fed to a mapper.

    Attributes:
        grid_mean_m: mean of 5 x 5 pixels over the plate, over the frames.
        column_sigma_m: normal fit with mean 0 to the deviations of column means from the plane.
        rows: rows that a column was averaged over.
    """

    grid_mean_m: float
    column_sigma_m: float
    rows: float


def paper_numbers(
    depth_mm: DepthStack, eroded: NDArray[np.bool_], plane: DisparityPlane
) -> PaperNumbers:
    """Return what section 3 of the paper computes from one cell.

    Args:
        depth_mm: (frames, height, width); 0 = no return.
        eroded: (height, width) pixels well on the plate.
        plane: the plate's; the column means' deviations are taken from it.
    """
    rows, columns = np.flatnonzero(eroded.any(axis=1)), np.flatnonzero(eroded.any(axis=0))
    box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    mask = eroded[box]
    v, u = np.mgrid[box].astype(np.float64)
    expected_mm = np.where(mask, 1e3 / plane.inverse_z(u, v), 0.0)
    whole, whole_mm = mask.sum(axis=0), expected_mm.sum(axis=0)
    sums, counts = [], []
    for frame in depth_mm[(slice(None), *box)] * mask:
        count = np.count_nonzero(frame, axis=0)
        is_whole = np.array_equal(count, whole)
        expected = whole_mm if is_whole else np.where(frame, expected_mm, 0.0).sum(axis=0)
        sums.append(frame.sum(axis=0, dtype=np.uint32) - expected)
        counts.append(count)
    count = np.array(counts)
    enough = count >= 0.5 * max(int(count.max()), 1)
    deviation_mm = np.array(sums)[enough] / count[enough]
    return PaperNumbers(
        grid_mean_m=_grid_mean_m(depth_mm, rows, columns),
        column_sigma_m=1e-3 * float(np.sqrt(np.mean(deviation_mm**2))),
        rows=float(np.mean(count[enough])),
    )


def _grid_mean_m(depth_mm: DepthStack, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> float:
    """Return the mean of the readings of 5 x 5 pixels spread evenly over the plate."""
    places = (np.arange(_GRID) + 0.5) / _GRID
    v = rows[(places * rows.size).astype(int)]
    u = columns[(places * columns.size).astype(int)]
    readings = depth_mm[:, v[:, np.newaxis], u]
    return 1e-3 * float(readings[readings > 0].mean()) if readings.any() else float("nan")


def lateral_sigma_px(
    depth_mm: DepthStack, plane: DisparityPlane, found: Outline
) -> tuple[float, int]:
    """Return the spread of the plate's upright edges about straight lines, and their readings.

    The place of an edge is a whole pixel; the spread of that, 1/12 px^2, is taken off.

    Args:
        depth_mm: (frames, height, width); 0 = no return.
        plane: the plate's.
        found: its outline; edges that are not seen are left out.
    """
    height, width = depth_mm.shape[1:]
    v, u = np.mgrid[:height, :width].astype(np.float64)
    inverse_mm = (1e-3 * plane.inverse_z(u, v)).astype(np.float32)
    variances: list[float] = []
    readings = 0
    for edge, mirrored in ((found.left, False), (found.right, True)):
        if not edge.is_seen or edge.last - edge.first < 20:
            continue
        lines = slice(edge.first, edge.last + 1)
        for frame in depth_mm[:_EDGE_FRAMES, lines]:
            on = np.abs(frame * inverse_mm[lines] - np.float32(1.0)) < _ON_PLATE
            variance, count = _edge_variance(on[:, ::-1] if mirrored else on, edge, width, mirrored)
            if count >= 20:
                variances.append(variance)
                readings += count
    if not variances:
        return float("nan"), 0
    variance = sum(variances) / len(variances) - 1.0 / 12.0
    return float(np.sqrt(max(variance, 0.0))), readings


def _edge_variance(
    on: NDArray[np.bool_], edge: Edge, width: int, mirrored: bool
) -> tuple[float, int]:
    """Return the variance of the first pixels on the plate about a line, and how many."""
    place = width - 1.0 - edge.place_px if mirrored else edge.place_px
    lines = np.arange(on.shape[0]) - 0.5 * on.shape[0]
    first = np.argmax(on, axis=1) - 0.5
    slope = -edge.slope if mirrored else edge.slope
    near = on.any(axis=1) & (np.abs(first - place - slope * lines) < _STRAY_PX)
    count = int(np.count_nonzero(near))
    if count < 20:
        return 0.0, 0
    residual = first[near] - np.polyval(np.polyfit(lines[near], first[near], 1), lines[near])
    return float(residual @ residual) / (count - 2), count
