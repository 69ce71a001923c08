"""The planes of `mapping.ground.layers` (numba, cached, no fast-math, fixed order of sums).

A disc of cells is given by `half`: half[k] is how many cells it reaches to either side in the
rows that are k away from its centre. The innermost loops run along a row over few arrays and
without a branch, so that the compiler can vectorise them; the sums of a disc are always added in
the same order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
# xx, xy, yy, xz, yz, zz.
Moments = tuple[float, float, float, float, float, float]

# Columns that are worked on together: their sums stay in the cache, and stand at constant distances
# from each other, so that the compiler can turn loops into vector instructions.
_CHUNK = 152
# Sums over a part of a row: cells, x, z, x^2, x z, z^2, noise, variance.
_N, _X, _Z, _XX, _XZ, _ZZ, _S, _V, _ROW_SUMS = range(0, 9 * _CHUNK, _CHUNK)
# Sums over a disc: those of its rows; then y, x y, y z, which are y times the first three; y^2.
_Y, _XY, _YZ, _YY, _DISC_SUMS = range(8 * _CHUNK, 13 * _CHUNK, _CHUNK)
# What is found of a plane: smallest eigenvalue, whether it needs more steps; normal, sigma of the
# slope, roughness, and its part from noise.
_ROOT, _OPEN, _NX, _NY, _NZ, _SIGMA, _ROUGH, _NOISE, _PLANE = range(0, 9 * _CHUNK, _CHUNK)
# Newton's step from the left converges to the smallest root without passing it; halving of the
# error, the worst case (a double root), reaches the limit of float64 in as many steps.
_NEWTON_STEPS_MAX = 60
# Squares of lengths in a disc that are below this share of the others are rounding.
_ROUNDING = 1e-9


class PlaneLayers(NamedTuple):
    """What a plane through the cells of a disc tells; (rows, columns), NaN = too little support.

    Unit normal, pointing up; where the cells form a line upwards its z is 0 and x and y are NaN.
    The others are as in `mapping.ground.layers.DerivedLayers`.
    """

    normal_x: Float32Array
    normal_y: Float32Array
    normal_z: Float32Array
    slope_sigma_rad: Float32Array
    roughness_m: Float32Array
    roughness_noise_m: Float32Array


class Cells(NamedTuple):
    """The cells that planes are laid through; all arrays (rows, columns).

    use: which cells count; the others may hold anything. noise_m2: variance of a height from
    the sensor's noise. local_m2: all of its variance that differs from cell to cell. middle_m: a
    height in the midst of the others. edge_m: of a cell.
    """

    use: NDArray[np.bool_]
    height_m: Float32Array
    noise_m2: Float32Array
    local_m2: Float32Array
    middle_m: float
    edge_m: float


@njit(cache=True, error_model="numpy")
def plane_layers(cells: Cells, half: IntArray, cells_min: int, out: PlaneLayers) -> None:
    """Fit a plane to every disc.

    Args:
        cells: the cells.
        half: the disc.
        cells_min: discs of fewer cells get NaN, and those whose centre does not count.
        out: the result.
    """
    reach = half.size - 1
    rows, columns = cells.use.shape
    # Sums of the discs that are not complete yet; that of row t at [t % rows of a disc].
    period = 2 * reach + 1
    discs = np.empty((period, _DISC_SUMS))
    sums, plane = np.empty(_ROW_SUMS), np.empty(_PLANE)
    row = np.zeros((4, _CHUNK + 2 * reach))
    for first in range(0, columns, _CHUNK):
        discs[:] = 0.0
        for i in range(rows + reach):
            if i < rows:
                _load_row(cells, i, first - reach, row)
                sums[:] = 0.0
                for width in range(half[0] + 1):
                    _widen(sums, row, width, reach)
                    for dy in range(-reach, reach + 1):
                        if half[abs(dy)] == width:
                            _add_row(discs[(i - dy) % period], sums, dy)
            complete = discs[(i - reach) % period]
            if i >= reach:
                _find_roots(complete, plane)
                _judge(complete, plane, cells.edge_m)
                _write(complete, plane, cells, cells_min, i - reach, first, out)
            complete[:] = 0.0


@njit(cache=True, error_model="numpy")
def _load_row(cells: Cells, i: int, first: int, row: Float64Array) -> None:
    """Write 1, height and both variances in units of a cell's edge; zeros where no cell counts.

    Around the middle of the map and in such units, sums of squares are exact to 1e-15 of them.
    `first`: column of the map at which the row begins; it may lie beside the map.
    """
    scale = 1.0 / cells.edge_m
    row[:] = 0.0
    start, end = max(-first, 0), min(row.shape[1], cells.use.shape[1] - first)
    there = slice(first + start, first + end)
    use = cells.use[i][there]
    for j in range(use.size):
        row[0, start + j] = 1.0 if use[j] else 0.0
    _load(row[1][start:], use, cells.height_m[i][there], cells.middle_m, scale)
    _load(row[2][start:], use, cells.noise_m2[i][there], 0.0, scale * scale)
    _load(row[3][start:], use, cells.local_m2[i][there], 0.0, scale * scale)


@njit(cache=True, error_model="numpy")
def _load(
    row: Float64Array, use: NDArray[np.bool_], values: Float32Array, middle: float, scale: float
) -> None:
    for j in range(use.size):
        value = scale * (values[j] - middle)
        row[j] = value if use[j] else 0.0


@njit(cache=True, error_model="numpy")
def _widen(sums: Float64Array, row: Float64Array, width: int, reach: int) -> None:
    """Add the two cells at `width` to either side of every centre to the sums."""
    right, left = reach + width, reach - width
    # Slices of whole rows: only of those does the compiler know that they are contiguous.
    n_right, n_left = row[0][right:], row[0][left:]
    z_right, z_left = row[1][right:], row[1][left:]
    once = 1.0 if width else 0.5  # the centre is its own mirror image
    w = float(width)
    for j in range(_CHUNK):
        sums[_N + j] += once * (n_right[j] + n_left[j])
        sums[_X + j] += w * (n_right[j] - n_left[j])
        sums[_XX + j] += w * w * (n_right[j] + n_left[j])
    for j in range(_CHUNK):
        sums[_Z + j] += once * (z_right[j] + z_left[j])
        sums[_ZZ + j] += once * (z_right[j] * z_right[j] + z_left[j] * z_left[j])
        sums[_XZ + j] += w * (z_right[j] - z_left[j])
    _add_pair(sums[_S:][:_CHUNK], row[2][right:], row[2][left:], once)
    _add_pair(sums[_V:][:_CHUNK], row[3][right:], row[3][left:], once)


@njit(cache=True, error_model="numpy")
def _add_pair(total: Float64Array, a: Float64Array, b: Float64Array, factor: float) -> None:
    for j in range(total.size):
        total[j] += factor * (a[j] + b[j])


@njit(cache=True, error_model="numpy")
def _add_row(disc: Float64Array, sums: Float64Array, dy: int) -> None:
    """Add the sums of a row that is `dy` from the centre to those of the disc."""
    y = float(dy)
    for j in range(_CHUNK):
        n, x, z = sums[_N + j], sums[_X + j], sums[_Z + j]
        disc[_N + j] += n
        disc[_X + j] += x
        disc[_Z + j] += z
        disc[_Y + j] += y * n
        disc[_XY + j] += y * x
        disc[_YZ + j] += y * z
        disc[_YY + j] += y * y * n
    for j in range(_XX, _ROW_SUMS):
        disc[j] += sums[j]


@njit(inline="always")
def _moments(disc: Float64Array, j: int) -> Moments:
    """Return the sums of squares around the mean of the cells of a disc."""
    n = disc[_N + j] if disc[_N + j] > 1.0 else 1.0
    mx, my, mz = disc[_X + j] / n, disc[_Y + j] / n, disc[_Z + j] / n
    xx, xy = disc[_XX + j] - mx * disc[_X + j], disc[_XY + j] - mx * disc[_Y + j]
    yy, zz = disc[_YY + j] - my * disc[_Y + j], disc[_ZZ + j] - mz * disc[_Z + j]
    xz, yz = disc[_XZ + j] - mx * disc[_Z + j], disc[_YZ + j] - my * disc[_Z + j]
    return xx, xy, yy, xz, yz, zz


@njit(inline="always")
def _step(m: Moments, root: float) -> float:
    """Return Newton's step towards the smallest root of det(A - root I), 0 at the root."""
    xx, xy, yy, xz, yz, zz = m
    trace = xx + yy + zz
    minors = xx * yy - xy * xy + xx * zz - xz * xz + yy * zz - yz * yz
    determinant = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    value = determinant - root * (minors - root * (trace - root))
    fall = minors - root * (2.0 * trace - 3.0 * root)
    onwards = (value > 0.0) & (fall > 0.0)
    # Selected before, so that no branch is left.
    return float((value if onwards else 0.0) / (fall if onwards else 1.0))


@njit(cache=True, error_model="numpy")
def _find_roots(disc: Float64Array, plane: Float64Array) -> None:
    """Find the smallest eigenvalues, 0 or more, of the moments of a chunk's discs.

    Four steps suffice where the cells hardly leave their plane; who needs more goes on alone.
    """
    for j in range(_CHUNK):
        m = _moments(disc, j)
        root = _step(m, 0.0)
        root += _step(m, root)
        root += _step(m, root)
        last = _step(m, root)
        root += last
        plane[_ROOT + j] = root
        # The error that a step leaves is its square.
        plane[_OPEN + j] = 1.0 if last > 1e-6 * root else 0.0
    for j in range(_CHUNK):
        if plane[_OPEN + j] > 0.0:
            m, root = _moments(disc, j), plane[_ROOT + j]
            for _ in range(_NEWTON_STEPS_MAX):
                last = _step(m, root)
                root += last
                if last <= 1e-6 * root:
                    break
            plane[_ROOT + j] = root


@njit(cache=True, error_model="numpy")
def _judge(disc: Float64Array, plane: Float64Array, edge_m: float) -> None:
    """Find what the planes of a chunk tell; NaN where the cells of a disc make no plane."""
    for j in range(_CHUNK):
        n, spread = disc[_N + j], plane[_ROOT + j]
        xx, xy, yy, xz, yz, _ = _moments(disc, j)
        # Spread of the cells across the line that they lie along; none: no plane.
        across = 0.5 * (xx + yy - np.sqrt((xx - yy) * (xx - yy) + 4.0 * xy * xy))
        a, b = xx - spread, yy - spread
        x, y, z = xy * yz - b * xz, xy * xz - a * yz, a * b - xy * xy
        z = z if z > 0.0 else 0.0
        length = np.sqrt(x * x + y * y + z * z)
        is_plane = across > _ROUNDING * (xx + yy)
        is_upright = length <= _ROUNDING * (xx + yy) * (xx + yy)
        lying = (0.0 if is_upright else 1.0) / (1.0 if is_upright else length)
        cosine = z * lying
        plane[_NX + j] = np.nan if is_upright else x * lying
        plane[_NY + j] = np.nan if is_upright else y * lying
        plane[_NZ + j] = cosine if is_plane else np.nan
        plane[_SIGMA + j] = np.sqrt(disc[_V + j] / n / across) * cosine * cosine
        plane[_ROUGH + j] = edge_m * np.sqrt(spread / (n - 1.0))
        noise_m = edge_m * np.sqrt(disc[_S + j] / n * (n - 3.0) / (n - 1.0))
        plane[_NOISE + j] = cosine * noise_m


@njit(cache=True, error_model="numpy")
def _write(
    disc: Float64Array,
    plane: Float64Array,
    cells: Cells,
    cells_min: int,
    i: int,
    first: int,
    out: PlaneLayers,
) -> None:
    """Write the layers of row `i` where a cell counts and its disc has enough cells and a plane."""
    use = cells.use[i][first:][:_CHUNK]
    for j in range(use.size):
        counts = use[j] & (disc[_N + j] >= cells_min) & (plane[_NZ + j] >= 0.0)
        plane[_OPEN + j] = 0.0 if counts else np.nan  # added to what is written
    _store(plane, _NX, out.normal_x[i][first:][:_CHUNK])
    _store(plane, _NY, out.normal_y[i][first:][:_CHUNK])
    _store(plane, _NZ, out.normal_z[i][first:][:_CHUNK])
    _store(plane, _SIGMA, out.slope_sigma_rad[i][first:][:_CHUNK])
    _store(plane, _ROUGH, out.roughness_m[i][first:][:_CHUNK])
    _store(plane, _NOISE, out.roughness_noise_m[i][first:][:_CHUNK])


@njit(inline="always")
def _store(plane: Float64Array, what: int, out: Float32Array) -> None:
    for j in range(out.size):
        out[j] = np.float32(plane[what + j] + plane[_OPEN + j])
