"""The per-cell loops of `mapping.ground.layers` (numba, cached, no fast-math, fixed order of sums).

A disc of cells is given by `half`: half[k] is how many cells it reaches to either side in the
rows that are k away from its centre. Arrays called "padded" have half.size - 1 more cells of "no
cell" on every side. The innermost loops run along a row over two or three arrays, so that the
compiler can vectorise them; the sums of a disc are always added in the same order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Sums over a part of a row: cells, x, z, x^2, x z, z^2, noise, variance.
_N, _X, _Z, _XX, _XZ, _ZZ, _S, _V, _ROW_SUMS = range(9)
# Sums over a disc: those of its rows; then y, x y, y z, which are y times the first three; y^2.
_Y, _XY, _YZ, _YY, _DISC_SUMS = range(8, 13)
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
        out: the result, all NaN before.
    """
    reach = half.size - 1
    rows, columns = cells.use.shape
    # Sums of the discs that are not complete yet; that of row t at [t % rows of a disc].
    period = 2 * reach + 1
    discs = np.zeros((period, _DISC_SUMS, columns))
    sums = np.empty((_ROW_SUMS, columns))
    row = np.zeros((4, columns + 2 * reach))
    for i in range(rows + reach):
        if i < rows:
            _load_row(cells, i, row[:, reach : reach + columns])
            sums[:] = 0.0
            for width in range(half[0] + 1):
                _widen(sums, row, width, reach)
                for dy in range(-reach, reach + 1):
                    if half[abs(dy)] == width:
                        _add_row(discs[(i - dy) % period], sums, dy)
        complete = (i - reach) % period
        if i >= reach:
            _solve_row(discs[complete], cells, cells_min, i - reach, out)
        discs[complete] = 0.0


@njit(cache=True, error_model="numpy")
def _load_row(cells: Cells, i: int, row: Float64Array) -> None:
    """Write 1, height and both variances in units of a cell's edge; zeros where no cell counts.

    Around the middle of the map and in such units, sums of squares are exact to 1e-15 of them.
    """
    scale = 1.0 / cells.edge_m
    for j in range(row.shape[1]):
        counts = cells.use[i, j]
        row[0, j] = 1.0 if counts else 0.0
        row[1, j] = scale * (cells.height_m[i, j] - cells.middle_m) if counts else 0.0
        row[2, j] = scale * scale * cells.noise_m2[i, j] if counts else 0.0
        row[3, j] = scale * scale * cells.local_m2[i, j] if counts else 0.0


@njit(cache=True, error_model="numpy", inline="always")
def _widen(sums: Float64Array, row: Float64Array, width: int, reach: int) -> None:
    """Add the two cells at `width` to either side of every centre to the sums."""
    right, left = reach + width, reach - width
    end_right, end_left = right + sums.shape[1], left + sums.shape[1]
    # Slices of whole rows: only of those does the compiler know that they are contiguous.
    n_right, n_left = row[0][right:end_right], row[0][left:end_left]
    z_right, z_left = row[1][right:end_right], row[1][left:end_left]
    s_right, s_left = row[2][right:end_right], row[2][left:end_left]
    v_right, v_left = row[3][right:end_right], row[3][left:end_left]
    once = 1.0 if width else 0.5  # the centre is its own mirror image
    _add_pair(sums[_N], n_right, n_left, once)
    _add_pair(sums[_Z], z_right, z_left, once)
    _add_squares(sums[_ZZ], z_right, z_left, once)
    _add_pair(sums[_S], s_right, s_left, once)
    _add_pair(sums[_V], v_right, v_left, once)
    if width:
        _add_difference(sums[_X], n_right, n_left, width)
        _add_pair(sums[_XX], n_right, n_left, width * width)
        _add_difference(sums[_XZ], z_right, z_left, width)


@njit(cache=True, error_model="numpy")
def _add_pair(total: Float64Array, a: Float64Array, b: Float64Array, factor: float) -> None:
    for j in range(total.size):
        total[j] += factor * (a[j] + b[j])


@njit(cache=True, error_model="numpy")
def _add_squares(total: Float64Array, a: Float64Array, b: Float64Array, factor: float) -> None:
    for j in range(total.size):
        total[j] += factor * (a[j] * a[j] + b[j] * b[j])


@njit(cache=True, error_model="numpy")
def _add_difference(total: Float64Array, a: Float64Array, b: Float64Array, factor: float) -> None:
    for j in range(total.size):
        total[j] += factor * (a[j] - b[j])


@njit(cache=True, error_model="numpy")
def _add_row(disc: Float64Array, sums: Float64Array, dy: int) -> None:
    """Add the sums of a row that is `dy` from the centre to those of the disc."""
    _add_scaled(disc[:_ROW_SUMS], sums, 1.0)
    if dy:
        _add_scaled(disc[_Y : _YZ + 1], sums[_N : _Z + 1], dy)
        _add_scaled(disc[_YY : _YY + 1], sums[_N : _N + 1], dy * dy)


@njit(cache=True, error_model="numpy")
def _add_scaled(total: Float64Array, a: Float64Array, factor: float) -> None:
    flat, added = total.reshape(-1), a.reshape(-1)  # one long loop
    for j in range(flat.size):
        flat[j] += factor * added[j]


@njit(cache=True, error_model="numpy")
def _solve_row(disc: Float64Array, cells: Cells, cells_min: int, i: int, out: PlaneLayers) -> None:
    """Turn the sums of the discs around row `i` into layers."""
    edge_m = cells.edge_m
    for j in range(disc.shape[1]):
        n = disc[_N, j]
        if not cells.use[i, j] or n < cells_min:
            continue
        mx, my, mz = disc[_X, j] / n, disc[_Y, j] / n, disc[_Z, j] / n
        xx, xy = disc[_XX, j] - mx * disc[_X, j], disc[_XY, j] - mx * disc[_Y, j]
        yy, zz = disc[_YY, j] - my * disc[_Y, j], disc[_ZZ, j] - mz * disc[_Z, j]
        xz, yz = disc[_XZ, j] - mx * disc[_Z, j], disc[_YZ, j] - my * disc[_Z, j]
        # Spread of the cells across the line that they lie along; none: no plane.
        across = 0.5 * (xx + yy - np.sqrt((xx - yy) * (xx - yy) + 4.0 * xy * xy))
        if across <= _ROUNDING * (xx + yy):
            continue
        spread = _smallest_eigenvalue(xx, xy, yy, xz, yz, zz)
        a, b = xx - spread, yy - spread
        x, y, z = xy * yz - b * xz, xy * xz - a * yz, max(a * b - xy * xy, 0.0)
        length = np.sqrt(x * x + y * y + z * z)
        cosine = 0.0
        if length > _ROUNDING * (xx + yy) * (xx + yy):
            cosine = z / length
            out.normal_x[i, j] = x / length
            out.normal_y[i, j] = y / length
        out.normal_z[i, j] = cosine
        out.slope_sigma_rad[i, j] = np.sqrt(disc[_V, j] / n / across) * cosine * cosine
        out.roughness_m[i, j] = edge_m * np.sqrt(spread / (n - 1.0))
        noise_m = edge_m * np.sqrt(disc[_S, j] / n * (n - 3.0) / (n - 1.0))
        out.roughness_noise_m[i, j] = cosine * noise_m


@njit(cache=True, error_model="numpy", inline="always")
def _smallest_eigenvalue(xx: float, xy: float, yy: float, xz: float, yz: float, zz: float) -> float:
    """Return the smallest root of det(A - root I), 0 or more, for the symmetric matrix A."""
    trace = xx + yy + zz
    minors = xx * yy - xy * xy + xx * zz - xz * xz + yy * zz - yz * yz
    determinant = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    root = 0.0
    for _ in range(_NEWTON_STEPS_MAX):
        value = determinant - root * (minors - root * (trace - root))
        fall = minors - root * (2.0 * trace - 3.0 * root)
        if value <= 0.0 or fall <= 0.0:
            break
        step = value / fall
        root += step
        if step <= 1e-6 * root:  # the error left is its square
            break
    return root


@njit(cache=True, error_model="numpy")
def step_heights(
    high: Float32Array, low: Float32Array, half: IntArray, cells_min: int, out: Float32Array
) -> None:
    """Write the range of heights in every disc.

    Args:
        high, low: padded heights; -inf and inf where there is no cell.
        half: the disc.
        cells_min: discs with fewer cells stay as they are, and those whose centre is no cell.
        out: (rows, columns), all NaN before.
    """
    reach = half.size - 1
    rows, columns = out.shape
    top, bottom = np.empty(columns, np.float32), np.empty(columns, np.float32)
    count = np.empty(columns, np.int32)
    for i in range(rows):
        top[:], bottom[:], count[:] = -np.inf, np.inf, 0
        for dy in range(-reach, reach + 1):
            row = i + reach + dy
            for dx in range(reach - half[abs(dy)], reach + half[abs(dy)] + 1):
                _raise(top, high[row, dx : dx + columns])
                _lower(bottom, low[row, dx : dx + columns])
                _count_above(count, high[row, dx : dx + columns], -np.inf)
        for j in range(columns):
            if high[i + reach, j + reach] > -np.inf and count[j] >= cells_min:
                out[i, j] = top[j] - bottom[j]


@njit(cache=True, error_model="numpy")
def supported_steps(
    steps: Float32Array, half: IntArray, critical_m: float, critical_cells: int, out: Float32Array
) -> None:
    """Write min(1, steps above critical / critical_cells) times the largest step of every disc.

    Args:
        steps: padded; -inf where there is none.
        half: the disc.
        critical_m, critical_cells: a step counts from this height, and fully with so many.
        out: (rows, columns), all NaN before; stays so where the centre has no step.
    """
    reach = half.size - 1
    rows, columns = out.shape
    top, count = np.empty(columns, np.float32), np.empty(columns, np.int32)
    for i in range(rows):
        top[:], count[:] = -np.inf, 0
        for dy in range(-reach, reach + 1):
            row = i + reach + dy
            for dx in range(reach - half[abs(dy)], reach + half[abs(dy)] + 1):
                _raise(top, steps[row, dx : dx + columns])
                _count_above(count, steps[row, dx : dx + columns], critical_m)
        for j in range(columns):
            if steps[i + reach, j + reach] > -np.inf:
                out[i, j] = top[j] * min(1.0, count[j] / critical_cells)


@njit(cache=True, error_model="numpy")
def _raise(top: Float32Array, values: Float32Array) -> None:
    for j in range(top.size):
        top[j] = max(top[j], values[j])


@njit(cache=True, error_model="numpy")
def _lower(bottom: Float32Array, values: Float32Array) -> None:
    for j in range(bottom.size):
        bottom[j] = min(bottom[j], values[j])


@njit(cache=True, error_model="numpy")
def _count_above(count: NDArray[np.int32], values: Float32Array, limit: float) -> None:
    for j in range(count.size):
        count[j] += values[j] > limit
