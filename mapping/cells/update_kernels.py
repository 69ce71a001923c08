"""The per-cell loop: one frame's sums per cell in, one Kalman update per cell out (numba, cached).

All arithmetic is float64; most stored layers are float32. Cells are taken in blocks: gathered into
one array, updated by a loop without a branch that the compiler turns into vector instructions, and
put back. Each cell is on its own, so the result depends neither on order nor on the vector width.
All compiled code that touches cells is in this file: numba looks for changes in the file of a
cached kernel, not in what it calls; whoever changes `mapping.cells.frame_errors` or the formula of
`mapping.noise` deletes the cache.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mapping.cells.cell_layers import CellLayers
from mapping.cells.frame_errors import common_m2, frames_m2, shared_m2, systematic
from mapping.cells.update_constants import FrameConstants, FusionConstants
from mapping.cells.update_types import (
    Known,
    Measurement,
    Sums,
    Systematic,
    UpdateCounts,
    Updated,
)
from mapping.motion.ledger import Motions
from mapping.noise import independent_readings

Float64Array = NDArray[np.float64]

# The array formula compiled for one cell at a time.
_independent: Any = njit(inline="always")(independent_readings)

_MOST_PIXELS = 2.0**32 - 1.0
_NOTHING_M2 = 1e-30
# Cells of a block: all their numbers stay in the first-level cache.
_BLOCK = 128
# Rows of a block's array: sums of the frame, place of the cell's middle, what the map knows.
_WEIGHT, _WEIGHT_HEIGHT, _WEIGHT_HEIGHT2, _PIXELS, _X, _Y = range(0, 6 * _BLOCK, _BLOCK)
_HEIGHT, _VARIANCE, _A, _B, _C, _BIAS, _RELIEF, _SEEN_PIXELS, _FRAMES, _SINCE = range(
    6 * _BLOCK, 16 * _BLOCK, _BLOCK
)
_XX, _XY, _YY, _STALE, _ACCEPTED = range(16 * _BLOCK, 21 * _BLOCK, _BLOCK)
_SIZE = 21 * _BLOCK


@njit(inline="always")
def _clamp(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


@njit(inline="always")
def _reduce(sums: Sums, c: FrameConstants) -> Measurement:
    """Precision-weighted mean of the cell's pixels and its variance n / (N_eff sum w)."""
    inverse = 1.0 / sums.pixels
    inverse_weight = 1.0 / sums.weight
    mean = sums.weight_height * inverse_weight
    spread = max(sums.weight_height2 * inverse_weight - mean * mean, 0.0)
    noise_m2 = sums.pixels * inverse_weight
    excess = spread * sums.pixels / max(sums.pixels - 1.0, 1.0) - noise_m2
    relief = excess if sums.pixels > 1.0 else 0.0
    own = noise_m2 / _independent(sums.pixels, c.correlation_area_px) + max(relief, 0.0) * inverse
    return Measurement(
        mean + c.camera_z_m,
        own,
        common_m2(c, sums.x_m, sums.y_m),
        systematic(c, sums.x_m, sums.y_m, mean),
        relief,
        sums.pixels,
    )


@njit(inline="always")
def _set_systematic(layers: CellLayers, row: int, column: int, s: Systematic) -> None:
    layers.systematic_a_m[row, column] = s.a_m
    layers.systematic_b_m[row, column] = s.b_m
    layers.systematic_c_m[row, column] = s.c_m
    layers.systematic_bias_m[row, column] = s.bias_m


@njit(inline="always")
def _blend(s: Systematic, other: Systematic, gain: float) -> Systematic:
    """Return (1 - gain) s + gain other."""
    return Systematic(
        s.a_m + gain * (other.a_m - s.a_m),
        s.b_m + gain * (other.b_m - s.b_m),
        s.c_m + gain * (other.c_m - s.c_m),
        s.bias_m + gain * (other.bias_m - s.bias_m),
    )


@njit(inline="always")
def _dot(s: Systematic, other: Systematic) -> float:
    return s.a_m * other.a_m + s.b_m * other.b_m + s.c_m * other.c_m + s.bias_m * other.bias_m


@njit(inline="always")
def _begin(
    layers: CellLayers, row: int, column: int, m: Measurement, t_ns: int, f: FusionConstants
) -> None:
    """First measurement of a cell."""
    layers.elevation_m[row, column] = m.height_m
    layers.variance_m2[row, column] = _clamp(m.own_m2 + m.common_m2, f.floor_m2, f.ceiling_m2)
    _set_systematic(layers, row, column, m.systematic)
    layers.relief_m2[row, column] = m.relief_m2
    layers.candidate_hits[row, column] = 0
    layers.frames[row, column] = 1
    layers.pixels[row, column] = np.uint32(m.pixels)
    layers.last_ns[row, column] = t_ns


@njit(inline="always")
def _challenge(
    layers: CellLayers, row: int, column: int, m: Measurement, t_ns: int, f: FusionConstants
) -> bool:
    """Give a measurement outside the gate to the second hypothesis; True when that takes over."""
    hits = layers.candidate_hits[row, column]
    known = float(layers.candidate_m2[row, column])
    innovation = m.height_m - float(layers.candidate_m[row, column])
    variance = known + m.own_m2 + 2.0 * m.common_m2 + max(m.relief_m2, 0.0)
    if hits > 0 and innovation * innovation <= f.gate2 * variance:
        gain = known / (known + m.own_m2)
        layers.candidate_m[row, column] += gain * innovation
        layers.candidate_m2[row, column] = (1.0 - gain) * known
        hits += 1
    else:
        layers.candidate_m[row, column] = m.height_m
        layers.candidate_m2[row, column] = m.own_m2
        hits = 1
    layers.candidate_hits[row, column] = hits
    if hits < f.confirmations:
        return False
    winner = float(layers.candidate_m[row, column])
    # The pose's error is common to hits that follow each other: it was not averaged away.
    variance = float(layers.candidate_m2[row, column]) + m.common_m2
    _begin(layers, row, column, m, t_ns, f)
    layers.elevation_m[row, column] = winner
    layers.variance_m2[row, column] = _clamp(variance, f.floor_m2, f.ceiling_m2)
    layers.frames[row, column] = np.uint32(f.confirmations)
    # Earlier hits had a pixel at least; fewer pixels than frames would upset the relief's share.
    layers.pixels[row, column] = np.uint32(max(m.pixels, float(f.confirmations)))
    return True


@njit(inline="always")
def _agrees(
    known: Known, m: Measurement, frames_m2: float, cell_size_m: float, f: FusionConstants
) -> bool:
    """Gate: squared innovation against the variance of both sides, all in m^2.

    A frame's relief counts as far as a slope can make it, (d/2)^2 at 60 degrees: more is the flank
    of something tall, which must not pass for ground because it is tall. The cell's own relief
    counts as far as the frame shows some too: a frame that sees level ground where something tall
    was has seen it gone.

    The constant errors count with |s|^2 + |m|^2 although both sides share them and the innovation's
    part is |s - m|^2: real frames of a moving camera differ by more than the model knows of.
    """
    innovation = m.height_m - known.height_m
    variance = known.variance_m2 + m.own_m2 + m.common_m2 + frames_m2
    variance += _dot(known.systematic, known.systematic) + _dot(m.systematic, m.systematic)
    slope_m2 = 0.25 * cell_size_m * cell_size_m
    relief_m2 = min(known.relief_m2, max(m.relief_m2, slope_m2))
    variance += max(min(m.relief_m2, slope_m2), relief_m2, 0.0)
    return innovation * innovation <= f.gate2 * variance


@njit(inline="always")
def _update(known: Known, m: Measurement, shared: float, f: FusionConstants) -> Updated:
    """Update of a known cell with a measurement inside the gate.

    V, R: variances that differ from frame to frame; s, m: sensitivities to the constant errors,
    of map and measurement. The gain that minimises (1 - K)^2 V + K^2 R + |(1 - K) s + K m|^2 is
    the Kalman gain where s = m, prefers the nearer view where they differ, and lets views from
    opposite sides cancel a crooked mount. It is held to K <= 2 V / (V + R), where (1 - K)^2 V +
    K^2 R <= V: a frame never makes a cell less sure of what frames differ by. A common error with
    correlation time tau that is seen again after dt < 2 tau brings no fresh information: it counts
    as variance * 2 tau / dt.
    What both sides share is taken off V and R, and stays, whatever K is:
    (1 - K)^2 V + K^2 R + 2 K (1 - K) C = (1 - K)^2 (V - C) + K^2 (R - C) + C.
    """
    repeated = max(2.0 * f.correlation_time_ns / max(known.since_ns, 1.0), 1.0)
    measured = m.own_m2 - shared + m.common_m2 * repeated
    mapped = known.variance_m2 - shared
    crossed = _dot(known.systematic, m.systematic)
    own = _dot(known.systematic, known.systematic)
    other = _dot(m.systematic, m.systematic)
    wanted = max(mapped + own - crossed, 0.0)
    # Both sides may hold nothing but what they share: then nothing is new, and K is 0.
    total = max(mapped + measured + max(own + other - 2.0 * crossed, 0.0), _NOTHING_M2)
    # The smaller of wanted / total and most / both, with one division.
    most, both = 2.0 * mapped, mapped + measured
    bound = wanted * both > most * total
    gain = min((most if bound else wanted) / (both if bound else total), 1.0)
    rest = 1.0 - gain
    variance = rest * rest * mapped + gain * gain * measured
    # Each frame's spread has one degree of freedom less than it has pixels.
    freedom = m.pixels - 1.0
    share = freedom / max(freedom + known.pixels - known.frames, 1.0)
    return Updated(
        known.height_m + gain * (m.height_m - known.height_m),
        _clamp(variance + shared, f.floor_m2, f.ceiling_m2),
        _blend(known.systematic, m.systematic, gain),
        known.relief_m2 + share * (m.relief_m2 - known.relief_m2),
        rest,
    )


@njit(inline="always")
def _sums_of(b: Float64Array, n: int) -> Sums:
    return Sums(
        b[_WEIGHT + n],
        b[_WEIGHT_HEIGHT + n],
        b[_WEIGHT_HEIGHT2 + n],
        b[_PIXELS + n],
        b[_X + n],
        b[_Y + n],
    )


@njit(cache=True, error_model="numpy")
def _update_block(b: Float64Array, c: FrameConstants, f: FusionConstants) -> None:
    """Gate and update every cell of a block in place; no branch, so that it becomes vectors.

    What is old in the height, by 1 - K, is where motions have moved it; what is new is in place.
    """
    for n in range(_BLOCK):
        m = _reduce(
            Sums(
                b[_WEIGHT + n],
                b[_WEIGHT_HEIGHT + n],
                b[_WEIGHT_HEIGHT2 + n],
                b[_PIXELS + n],
                b[_X + n],
                b[_Y + n],
            ),
            c,
        )
        known = Known(
            b[_HEIGHT + n],
            b[_VARIANCE + n],
            Systematic(b[_A + n], b[_B + n], b[_C + n], b[_BIAS + n]),
            b[_RELIEF + n],
            b[_SEEN_PIXELS + n],
            b[_FRAMES + n],
            b[_SINCE + n],
        )
        u = _update(known, m, shared_m2(known, m, c), f)
        stale_m2 = frames_m2(c, b[_X + n], b[_Y + n], b[_STALE + n])
        b[_ACCEPTED + n] = 1.0 if _agrees(known, m, stale_m2, c.cell_size_m, f) else 0.0
        b[_HEIGHT + n] = u.height_m
        b[_VARIANCE + n] = u.variance_m2
        b[_A + n] = u.systematic.a_m
        b[_B + n] = u.systematic.b_m
        b[_C + n] = u.systematic.c_m
        b[_BIAS + n] = u.systematic.bias_m
        b[_RELIEF + n] = u.relief_m2
        b[_XX + n] *= u.rest * u.rest
        b[_XY + n] *= u.rest * u.rest
        b[_YY + n] *= u.rest * u.rest
        b[_STALE + n] *= u.rest


@njit(cache=True, error_model="numpy")
def _find_touched(sums: Float64Array, cells: int, touched: NDArray[np.uint32]) -> int:
    """List the cells of the window that have a sum, in ascending order; return how many."""
    found = np.uint64(0)
    for k in range(cells):
        touched[found] = k
        found += np.uint64(sums[k, 3] > 0.0)
    return int(found)


@njit(inline="always")
def _flat(layers: CellLayers) -> CellLayers:
    """Return the layers as arrays of one dimension."""
    return CellLayers(
        layers.elevation_m.reshape(-1),
        layers.variance_m2.reshape(-1),
        layers.systematic_a_m.reshape(-1),
        layers.systematic_b_m.reshape(-1),
        layers.systematic_c_m.reshape(-1),
        layers.systematic_bias_m.reshape(-1),
        layers.relief_m2.reshape(-1),
        layers.candidate_m.reshape(-1),
        layers.candidate_m2.reshape(-1),
        layers.candidate_hits.reshape(-1),
        layers.frames.reshape(-1),
        layers.pixels.reshape(-1),
        layers.last_ns.reshape(-1),
        layers.motion.reshape(-1),
        layers.horizontal_xx_m2.reshape(-1),
        layers.horizontal_xy_m2.reshape(-1),
        layers.horizontal_yy_m2.reshape(-1),
        layers.stale_m.reshape(-1),
        layers.seen_through.reshape(-1),
        layers.hidden.reshape(-1),
    )


@njit(cache=True, error_model="numpy")
def _gather(
    sums: Float64Array,
    touched: NDArray[np.uint32],
    c: FrameConstants,
    columns: int,
    layers: CellLayers,
    b: Float64Array,
    places: NDArray[np.int64],
) -> None:
    """Put sums, place and what the map knows of the touched cells into a block; clear the sums."""
    rows = layers.elevation_m.shape[0] // columns
    j = int(touched[0]) // c.cells_x
    for n in range(touched.shape[0]):
        k = touched[n]
        i = int(k) - j * c.cells_x
        while i >= c.cells_x:
            i -= c.cells_x
            j += 1
        for column in range(4):
            b[column * _BLOCK + n] = sums[k, column]
            sums[k, column] = 0.0
        b[_X + n] = c.corner_x_m + (i + 0.5) * c.cell_size_m
        b[_Y + n] = c.corner_y_m + (j + 0.5) * c.cell_size_m
        row, column = c.first_row + j, c.first_column + i
        row -= rows if row >= rows else 0
        column -= columns if column >= columns else 0
        places[n] = row * columns + column
        # An unsigned index spares the compiler the case of one below 0.
        p = np.uint64(places[n])
        b[_HEIGHT + n] = layers.elevation_m[p]
        b[_VARIANCE + n] = layers.variance_m2[p]
        b[_A + n] = layers.systematic_a_m[p]
        b[_B + n] = layers.systematic_b_m[p]
        b[_C + n] = layers.systematic_c_m[p]
        b[_BIAS + n] = layers.systematic_bias_m[p]
        b[_RELIEF + n] = layers.relief_m2[p]
        b[_SEEN_PIXELS + n] = layers.pixels[p]
        b[_FRAMES + n] = layers.frames[p]
        b[_SINCE + n] = float(c.t_ns - layers.last_ns[p])


@njit(cache=True, error_model="numpy")
def _catch_up(
    layers: CellLayers,
    places: NDArray[np.int64],
    motions: Motions,
    c: FrameConstants,
    b: Float64Array,
) -> None:
    """Add to the block what the motions since each cell's last update have done to it.

    J (S - S') J' with J = [1, 0, -y; 0, 1, x]; see `mapping.motion.ledger`.
    """
    to_anchor_x_m = c.camera_x_m - motions.anchor_x_m
    to_anchor_y_m = c.camera_y_m - motions.anchor_y_m
    now = motions.sums[motions.now]
    learned = np.uint32(motions.now)
    xx, xy, yy, along_x, along_y, yaw, zz, way = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for n in range(places.shape[0]):
        p = np.uint64(places[n])
        # Neighbours were mostly seen together, and share what they have missed.
        if layers.motion[p] != learned:
            learned = layers.motion[p]
            # A cell that another run has stored may have learned of more motions than there are.
            then = motions.sums[min(learned, np.uint32(motions.now))]
            xx, xy, yy = now[0] - then[0], now[1] - then[1], now[2] - then[2]
            along_x, along_y, yaw = now[3] - then[3], now[4] - then[4], now[5] - then[5]
            zz, way = now[6] - then[6], now[7] - then[7]
        x, y = b[_X + n] + to_anchor_x_m, b[_Y + n] + to_anchor_y_m
        gained_xx = xx - 2.0 * y * along_x + y * y * yaw
        gained_xy = xy + x * along_x - y * along_y - x * y * yaw
        gained_yy = yy + 2.0 * x * along_y + x * x * yaw
        b[_XX + n] = layers.horizontal_xx_m2[p] + max(gained_xx, 0.0)
        b[_XY + n] = layers.horizontal_xy_m2[p] + gained_xy
        b[_YY + n] = layers.horizontal_yy_m2[p] + max(gained_yy, 0.0)
        b[_VARIANCE + n] += zz
        b[_STALE + n] = layers.stale_m[p] + way


@njit(cache=True, error_model="numpy")
def _scatter(
    layers: CellLayers,
    flat: CellLayers,
    places: NDArray[np.int64],
    c: FrameConstants,
    f: FusionConstants,
    b: Float64Array,
) -> UpdateCounts:
    """Put the accepted cells of a block back; begin new ones, challenge those outside the gate."""
    rejected = 0
    replaced = 0
    for n in range(places.shape[0]):
        p = np.uint64(places[n])
        if b[_FRAMES + n] > 0.0 and b[_ACCEPTED + n] > 0.0:
            flat.elevation_m[p] = b[_HEIGHT + n]
            flat.variance_m2[p] = b[_VARIANCE + n]
            flat.systematic_a_m[p] = b[_A + n]
            flat.systematic_b_m[p] = b[_B + n]
            flat.systematic_c_m[p] = b[_C + n]
            flat.systematic_bias_m[p] = b[_BIAS + n]
            flat.relief_m2[p] = b[_RELIEF + n]
            flat.candidate_hits[p] = max(flat.candidate_hits[p], 1) - 1
            flat.frames[p] += np.uint32(1)
            pixels = min(b[_SEEN_PIXELS + n] + b[_PIXELS + n], _MOST_PIXELS)
            flat.pixels[p] = np.uint32(pixels)
            flat.last_ns[p] = c.t_ns
            continue
        row, column = divmod(places[n], layers.elevation_m.shape[1])
        m = _reduce(_sums_of(b, n), c)
        begun = b[_FRAMES + n] == 0.0
        if begun:
            _begin(layers, row, column, m, c.t_ns, f)
        else:
            begun = _challenge(layers, row, column, m, c.t_ns, f)
            rejected += 1
            replaced += begun
        b[_ACCEPTED + n] = 0.0
        b[_FRAMES + n] = 0.0 if begun else b[_FRAMES + n]
    return UpdateCounts(places.shape[0], rejected, replaced)


@njit(cache=True, error_model="numpy")
def _scatter_motion(
    layers: CellLayers, places: NDArray[np.int64], now: int, b: Float64Array
) -> None:
    """Store what motions have done to the accepted cells of a block; a new one starts at zero."""
    for n in range(places.shape[0]):
        p = np.uint64(places[n])
        begun = b[_FRAMES + n] == 0.0
        if begun or b[_ACCEPTED + n] > 0.0:
            layers.motion[p] = now
            layers.horizontal_xx_m2[p] = 0.0 if begun else b[_XX + n]
            layers.horizontal_xy_m2[p] = 0.0 if begun else b[_XY + n]
            layers.horizontal_yy_m2[p] = 0.0 if begun else b[_YY + n]
            layers.stale_m[p] = 0.0 if begun else b[_STALE + n]


@njit(cache=True, error_model="numpy")
def fuse(
    sums: Float64Array,
    c: FrameConstants,
    f: FusionConstants,
    layers: CellLayers,
    motions: Motions,
) -> UpdateCounts:
    """Fuse one frame into the layers; `sums` (cells_y * cells_x, 4) is cleared behind it.

    `motions`: those up to the frame, see `mapping.motion.ledger`.
    """
    touched = np.empty(c.cells_x * c.cells_y + 1, np.uint32)
    cells = _find_touched(sums, c.cells_x * c.cells_y, touched)
    block = np.zeros(_SIZE)
    every_place = np.empty(_BLOCK, np.int64)
    flat = _flat(layers)
    columns = layers.elevation_m.shape[1]
    rejected = 0
    replaced = 0
    for start in range(0, cells, _BLOCK):
        some = touched[start : min(start + _BLOCK, cells)]
        places = every_place[: some.shape[0]]
        _gather(sums, some, c, columns, flat, block, places)
        if motions.now > 0:
            _catch_up(flat, places, motions, c, block)
        _update_block(block, c, f)
        counts = _scatter(layers, flat, places, c, f, block)
        if motions.now > 0:
            _scatter_motion(flat, places, motions.now, block)
        rejected += counts.rejected
        replaced += counts.replaced
    return UpdateCounts(cells, rejected, replaced)
