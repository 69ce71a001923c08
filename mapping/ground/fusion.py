"""The fused map: what the errors of a cell's place make of its height.

The place of a cell is known up to an ellipse, its horizontal covariance Sigma_xy (Fankhauser et
al., "Probabilistic Terrain Mapping for Mobile Robots With Uncertain Localization", RA-L 2018).
Every confirmed cell becomes the mean over that ellipse, weights w = exp(-o' Sigma_xy^-1 o / 2) at
the offsets o of the confirmed cells inside 3.5 sigma:

    elevation = sum w h / sum w
    variance  = sum w (h^2 + V) / sum w - elevation^2,   V = variance of h without the place's part
    lower     = least h - 3 sqrt(V),      upper = largest h + 3 sqrt(V)

On a plane of slope g the variance is V + g' Sigma_xy g. The bounds are those of the ground that
may be there, not three times a sigma: beside a step they do not reach beyond top and bottom; on a
plane they are 0.7 to 1.6 times as far away as three of these sigmas, by how cells fall into the
ellipse.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapping.cells.elevation_map import ElevationMap
from mapping.errors import MappingError
from mapping.ground.fusion_kernels import REACH_SIGMA, Fused, Places, Surface, integrate
from mapping.judging.evaluation import CONFIRMED

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]

_TABLE_SIZE = 257
# A place that is less certain than 100 cells counts as if it were known to 100 cells.
_LARGEST_CELLS2 = np.float32(100.0**2)
_WHOLE = (slice(None), slice(None))


@dataclass(frozen=True, slots=True)
class FusedMap:
    """The fused layers of a map or of a window of it; NaN where no cell is confirmed.

    Attributes:
        elevation_m, variance_m2: mean over the ellipse and its variance.
        lower_m, upper_m: bounds, 3 sigma in height and in place.
    """

    elevation_m: Float32Array
    variance_m2: Float32Array
    lower_m: Float32Array
    upper_m: Float32Array


def fuse_map(map_: ElevationMap, window: tuple[slice, slice] = _WHOLE) -> FusedMap:
    """Return the fused layers of the cells map_[window]; the same bits as those of the whole map.

    Raises:
        MappingError: the window is no plain range of rows and columns.
    """
    shape = map_.state.shape
    (row, _, row_step), (column, _, column_step) = (
        part.indices(size) for part, size in zip(window, shape, strict=True)
    )
    if row_step != 1 or column_step != 1:
        raise MappingError(f"window {window} has a step; expected slices of neighbouring cells")
    out = Fused(*(np.full(map_.state[window].shape, np.nan, np.float32) for _ in Fused._fields))
    cells = np.full(out.elevation_m.shape, 1.0 / map_.resolution_m**2, np.float32)
    covariance = (map_.horizontal_xx_m2, map_.horizontal_xy_m2, map_.horizontal_yy_m2)
    whole = map_.horizontal_xx_m2[window] + map_.horizontal_yy_m2[window]
    cells *= _LARGEST_CELLS2 / np.maximum(whole * cells, _LARGEST_CELLS2)
    places = Places(*(np.ascontiguousarray(layer[window] * cells) for layer in covariance))
    margin = 2 + int(REACH_SIGMA * np.sqrt(np.nanmax(whole * cells, initial=1.0)))
    integrate(_surface(map_, margin), places, row + margin, column + margin, _NARROW, out)
    return FusedMap(*out)


def _surface(map_: ElevationMap, margin: int) -> Surface:
    use = np.isfinite(map_.elevation_m) & np.isfinite(map_.variance_m2)
    use &= (map_.state == CONFIRMED[0]) | (map_.state == CONFIRMED[1])
    vertical = np.maximum(map_.variance_m2 - map_.horizontal_m2, np.float32(0.0))
    bound = np.float32(3.0) * np.sqrt(vertical)

    def padded(layer: Float32Array, elsewhere: float) -> Float32Array:
        wide = np.full([size + 2 * margin for size in use.shape], elsewhere, np.float32)
        inside = wide[margin : margin + use.shape[0], margin : margin + use.shape[1]]
        np.copyto(inside, layer, where=use)
        return wide

    return Surface(
        padded(np.ones_like(bound), 0.0),
        padded(map_.elevation_m, 0.0),
        padded(vertical, 0.0),
        padded(map_.elevation_m - bound, np.inf),
        padded(map_.elevation_m + bound, -np.inf),
    )


def narrow_table() -> Float64Array:
    """Return the widths a for which samples exp(-i^2 / 2a) have the variances 0 to 1, in cells^2.

    A Gaussian much narrower than a cell, such as d/2, has less variance when it is sampled at
    whole cells than it has by its formula; from 0.6 cells of sigma on they are the same.
    """
    width = np.geomspace(1e-3, 1.5, 2000)
    i = np.arange(-12, 13)
    samples = np.exp(-0.5 * i**2 / width[:, np.newaxis])
    variance = samples @ i**2 / samples.sum(axis=1)
    table: Float64Array = np.interp(np.linspace(0.0, 1.0, _TABLE_SIZE), variance, width)
    return table


_NARROW = narrow_table()
