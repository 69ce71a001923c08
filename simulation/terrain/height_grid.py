"""The one ground that physics, depth camera and truth share: a triangulated grid of heights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from simulation.errors import SimulationError

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]

# Positions this share of a square beyond the last node are on it: rounding of floats.
_EDGE = 1e-6


@njit(cache=True, nogil=True, error_model="numpy")
def surface_plane(
    height_m: Float32Array,
    origin_x_m: float,
    origin_y_m: float,
    spacing_m: float,
    x_m: float,
    y_m: float,
) -> tuple[float, float, float]:
    """Return height, dz/dx and dz/dy of the triangle at (x, y); three NaN outside the grid.

    Every square is split along the diagonal from node (r, c) to (r+1, c+1), as MuJoCo's height
    fields are.
    """
    across = (x_m - origin_x_m) / spacing_m
    along = (y_m - origin_y_m) / spacing_m
    rows, columns = height_m.shape
    if not (-_EDGE <= across <= columns - 1 + _EDGE and -_EDGE <= along <= rows - 1 + _EDGE):
        return np.nan, np.nan, np.nan
    c = min(int(across), columns - 2)
    r = min(int(along), rows - 2)
    corner = np.float64(height_m[r, c])
    opposite = np.float64(height_m[r + 1, c + 1])
    if across - c >= along - r:
        beside = np.float64(height_m[r, c + 1])
        step_x, step_y = beside - corner, opposite - beside
    else:
        above = np.float64(height_m[r + 1, c])
        step_x, step_y = opposite - above, above - corner
    height = corner + (across - c) * step_x + (along - r) * step_y
    return height, step_x / spacing_m, step_y / spacing_m


@njit(cache=True, nogil=True, error_model="numpy")
def surface_height(
    height_m: Float32Array,
    origin_x_m: float,
    origin_y_m: float,
    spacing_m: float,
    x_m: float,
    y_m: float,
) -> float:
    """Return the height of the triangulated surface at (x, y), metres; NaN outside the grid."""
    height, _, _ = surface_plane(height_m, origin_x_m, origin_y_m, spacing_m, x_m, y_m)
    return height


@njit(cache=True, nogil=True, error_model="numpy")
def _fill_planes(
    height_m: Float32Array,
    origin_x_m: float,
    origin_y_m: float,
    spacing_m: float,
    x_m: Float64Array,
    y_m: Float64Array,
    planes: Float64Array,
) -> None:
    for i in range(x_m.size):
        plane = surface_plane(height_m, origin_x_m, origin_y_m, spacing_m, x_m[i], y_m[i])
        planes[0, i], planes[1, i], planes[2, i] = plane


@dataclass(frozen=True, slots=True)
class HeightGrid:
    """Heights on a square grid, and the surface of triangles between them.

    The world frame has z up. Node [r, c] stands at (origin_x_m + c spacing_m,
    origin_y_m + r spacing_m).

    Attributes:
        origin_x_m, origin_y_m: position of node [0, 0].
        spacing_m: distance between neighbouring nodes, along x and along y.
        height_m: (rows = y, columns = x) float32, read-only; at least 2 x 2, finite.
    """

    origin_x_m: float
    origin_y_m: float
    spacing_m: float
    height_m: Float32Array

    def __post_init__(self) -> None:
        """Keep an own read-only copy; refuse what is no surface."""
        height_m = np.array(self.height_m, dtype=np.float32, order="C")
        if height_m.ndim != 2 or min(height_m.shape) < 2:
            raise SimulationError(
                f"a height grid of shape {height_m.shape}; expected at least 2 x 2 nodes"
            )
        if not (self.spacing_m > 0.0 and np.isfinite(self.spacing_m)):
            raise SimulationError(f"a grid spacing of {self.spacing_m} m; expected more than 0")
        if not (np.isfinite(self.origin_x_m) and np.isfinite(self.origin_y_m)):
            raise SimulationError("a height grid whose origin is not finite; give metres")
        if not np.isfinite(height_m).all():
            holes = int(np.count_nonzero(~np.isfinite(height_m)))
            raise SimulationError(f"a height grid with {holes} nodes without height; fill them")
        height_m.flags.writeable = False
        object.__setattr__(self, "height_m", height_m)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Return x_min, x_max, y_min, y_max of the nodes, metres."""
        rows, columns = self.height_m.shape
        x_max = self.origin_x_m + (columns - 1) * self.spacing_m
        y_max = self.origin_y_m + (rows - 1) * self.spacing_m
        return self.origin_x_m, x_max, self.origin_y_m, y_max

    @property
    def x_m(self) -> Float64Array:
        """Return the (columns,) positions of the nodes along x."""
        return self.origin_x_m + self.spacing_m * np.arange(
            self.height_m.shape[1], dtype=np.float64
        )

    @property
    def y_m(self) -> Float64Array:
        """Return the (rows,) positions of the nodes along y."""
        return self.origin_y_m + self.spacing_m * np.arange(
            self.height_m.shape[0], dtype=np.float64
        )

    def height_at(self, x_m: ArrayLike, y_m: ArrayLike) -> Float64Array:
        """Return heights on the triangles, of the shape that x and y broadcast to; NaN outside."""
        heights, _, _ = self._planes(x_m, y_m)
        return heights

    def normal_at(self, x_m: ArrayLike, y_m: ArrayLike) -> Float64Array:
        """Return (..., 3) unit normals of the triangles, pointing up; NaN outside."""
        _, slope_x, slope_y = self._planes(x_m, y_m)
        normal = np.stack([-slope_x, -slope_y, np.where(np.isnan(slope_x), np.nan, 1.0)], axis=-1)
        return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True), np.float64)

    def slope(self, x_m: ArrayLike, y_m: ArrayLike) -> Float64Array:
        """Return the angle between the triangles and the horizontal, radians; NaN outside."""
        _, slope_x, slope_y = self._planes(x_m, y_m)
        return np.asarray(np.arctan(np.hypot(slope_x, slope_y)), np.float64)

    def _planes(
        self, x_m: ArrayLike, y_m: ArrayLike
    ) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Return height, dz/dx and dz/dy."""
        x, y = np.broadcast_arrays(np.asarray(x_m, float), np.asarray(y_m, float))
        planes = np.empty((3, x.size))
        _fill_planes(
            self.height_m,
            self.origin_x_m,
            self.origin_y_m,
            self.spacing_m,
            x.ravel(),
            y.ravel(),
            planes,
        )
        height, slope_x, slope_y = planes.reshape((3, *x.shape))
        return height, slope_x, slope_y
