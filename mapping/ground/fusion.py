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
plane they are 0.7 to 1.7 times as far away as three of these sigmas, by how cells and blocks fall
into the ellipse.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapping.cells.elevation_map import ElevationMap
from mapping.errors import MappingError
from mapping.ground.fusion_kernels import CHUNK, Fused, integrate
from mapping.ground.place_kernels import REACH_SIGMA, Places, choose_blocks, widest_places
from mapping.ground.surface_kernels import Surface, load_surface, mean_height, over_blocks
from mapping.judging.evaluation import CONFIRMED

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_TABLE_SIZE = 257
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
    use = np.isfinite(map_.elevation_m) & np.isfinite(map_.variance_m2)
    use &= (map_.state == CONFIRMED[0]) | (map_.state == CONFIRMED[1])
    places = _places(map_, window, use)
    level_m = mean_height(map_.elevation_m, use)
    widest = widest_places(places)
    sizes = [int(block) for block in np.flatnonzero(widest) if block > 0]
    # How many cells the ellipses, with half a block at their rim, reach beyond the map at most.
    margin = max((int(REACH_SIGMA * widest[n] ** 0.5) + 3 * n for n in sizes), default=0)
    surface = _surface(map_, use, level_m, margin)
    first = row + margin, column + margin
    for block in sizes:
        blocks = surface
        if block > 1:
            blocks = _empty(surface.share.shape)
            over_blocks(surface, block, blocks)
        integrate(blocks, places, first, block, level_m, _NARROW, out)
    return FusedMap(*out)


def _places(map_: ElevationMap, window: tuple[slice, slice], use: BoolArray) -> Places:
    """Return the ellipses of a window, and at which blocks each is sampled."""
    xx_m2, xy_m2, yy_m2 = (
        np.ascontiguousarray(layer[window])
        for layer in (map_.horizontal_xx_m2, map_.horizontal_xy_m2, map_.horizontal_yy_m2)
    )
    counts = np.ascontiguousarray(use[window])
    places = Places(
        np.zeros_like(xx_m2),
        np.zeros_like(xy_m2),
        np.zeros_like(yy_m2),
        np.zeros(counts.shape, np.int64),
    )
    choose_blocks(xx_m2, xy_m2, yy_m2, counts, 1.0 / map_.resolution_m**2, places)
    return places


def _surface(map_: ElevationMap, use: BoolArray, level_m: float, margin: int) -> Surface:
    """Return what is integrated, at every cell.

    The margin is wider on the right: cells are worked on in chunks.
    """
    rows, columns = use.shape
    surface = _empty((rows + 2 * margin, columns + 2 * margin + CHUNK))
    layers = map_.elevation_m, map_.variance_m2, map_.horizontal_m2
    load_surface(*layers, use, level_m, margin, surface)
    return surface


def _empty(shape: tuple[int, ...]) -> Surface:
    """Return a surface of which no cell counts."""
    return Surface(
        *(np.full(shape, value, np.float32) for value in (0.0, 0.0, 0.0, np.inf, -np.inf))
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
