"""How rough the map is around each cell (numba, cached, fixed order)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_HALF_WIDTH = 2
_FEWEST_CELLS = 6


@njit(inline="always")
def _plane_residual(s: NDArray[np.float64]) -> float:
    """Return the residual variance of a plane through points, from their sums; 0 if undefined.

    s: 1, x, y, xx, xy, yy, h, hx, hy, hh. Cramer's rule on the normal equations.
    """
    n, x, y, xx, xy, yy, h, hx, hy, hh = s
    a = xx * yy - xy * xy
    b = xy * y - x * yy
    c = x * xy - xx * y
    determinant = n * a + x * b + y * c
    if n < _FEWEST_CELLS or determinant <= 1e-9 * n * n * n:
        return 0.0
    d = n * yy - y * y
    e = x * y - n * xy
    f = n * xx - x * x
    level = a * h + b * hx + c * hy
    slope_x = b * h + d * hx + e * hy
    slope_y = c * h + e * hx + f * hy
    explained = (level * h + slope_x * hx + slope_y * hy) / determinant
    return float(max(hh - explained, 0.0) / (n - 3.0))


@njit(cache=True, error_model="numpy")
def surrounding_relief(
    height_m: NDArray[np.float64],
    variance_m2: NDArray[np.float32],
    confirmed: NDArray[np.bool_],
    relief_m2: NDArray[np.float32],
) -> None:
    """Fill `relief_m2`: variance of the heights in 5 x 5 cells around a plane through them.

    What their own noise explains is taken off. 0 where fewer than six confirmed cells, or only
    cells in a line, are there. Arrays (rows, columns).
    """
    rows, columns = height_m.shape
    sums = np.empty(10)
    for j in range(rows):
        for i in range(columns):
            relief_m2[j, i] = 0.0
            if not confirmed[j, i]:
                continue
            sums[:] = 0.0
            noise = 0.0
            for v in range(max(j - _HALF_WIDTH, 0), min(j + _HALF_WIDTH + 1, rows)):
                for u in range(max(i - _HALF_WIDTH, 0), min(i + _HALF_WIDTH + 1, columns)):
                    if confirmed[v, u]:
                        x = float(u - i)
                        y = float(v - j)
                        h = height_m[v, u] - height_m[j, i]
                        noise += variance_m2[v, u]
                        for k, term in enumerate(
                            (1.0, x, y, x * x, x * y, y * y, h, h * x, h * y, h * h)
                        ):
                            sums[k] += term
            relief_m2[j, i] = max(_plane_residual(sums) - noise / sums[0], 0.0)
