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
from mapping.ground.fusion_kernels import (
    CHUNK,
    REACH_SIGMA,
    Fused,
    Places,
    Surface,
    choose_blocks,
    integrate,
)
from mapping.judging.evaluation import CONFIRMED

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_TABLE_SIZE = 257
# How the layers of a `Surface` are put together over a block, and what they are outside.
_COMBINED = ((np.add, 0.0),) * 3 + ((np.minimum, np.inf), (np.maximum, -np.inf))
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
    level_m = float(map_.elevation_m[use].mean(dtype=np.float64)) if use.any() else 0.0
    surface = _surface(map_, use, level_m)
    for block in _sizes(places.blocks):
        margin = _margin(places, block)
        blocks = Surface(
            *(
                _over_blocks(layer, block, margin, combine, elsewhere)
                for layer, (combine, elsewhere) in zip(surface, _COMBINED, strict=True)
            )
        )
        integrate(blocks, places, (row + margin, column + margin), block, level_m, _NARROW, out)
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


def _sizes(blocks: NDArray[np.int64]) -> list[int]:
    """Return the sizes above 0 that are there, in order."""
    return [int(n) for n in np.flatnonzero(np.bincount(blocks.reshape(-1))) if n > 0]


def _margin(places: Places, block: int) -> int:
    """Return how many cells the ellipses with such blocks reach beyond the map, at most."""
    widest = max(
        float(layer.max(where=places.blocks == block, initial=0.0))
        for layer in (places.xx, places.yy)
    )
    return int(REACH_SIGMA * widest**0.5) + 3 * block


def _surface(map_: ElevationMap, use: BoolArray, level_m: float) -> Surface:
    """Return what is integrated, at every cell, without a margin."""
    vertical = np.maximum(map_.variance_m2 - map_.horizontal_m2, np.float32(0.0))
    bound = np.float32(3.0) * np.sqrt(vertical)
    height = np.where(use, map_.elevation_m.astype(np.float64) - level_m, 0.0)
    return Surface(
        use.astype(np.float64),
        height,
        np.where(use, height * height + vertical, 0.0),
        np.where(use, (map_.elevation_m - bound).astype(np.float64), np.inf),
        np.where(use, (map_.elevation_m + bound).astype(np.float64), -np.inf),
    )


def _over_blocks(
    layer: Float64Array, block: int, margin: int, combine: np.ufunc, elsewhere: float
) -> Float64Array:
    """Return what the block around every cell holds together, with a margin.

    The margin is wider on the right: cells are worked on in chunks.
    """
    rows, columns = layer.shape
    wide = np.full((rows + 2 * margin, columns + 2 * margin + CHUNK), elsewhere)
    wide[margin : margin + rows, margin : margin + columns] = layer
    cells = wide.reshape(-1)  # what goes beyond a row's end comes from the margin
    for step in (1, wide.shape[1]):
        plain = cells.copy() if block > 1 else cells
        for away in range(step, block // 2 * step + 1, step):
            combine(cells[away:], plain[:-away], out=cells[away:])
            combine(cells[:-away], plain[away:], out=cells[:-away])
    return wide


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
