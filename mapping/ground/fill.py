"""Gaps of a map closed between their rims, with a variance learned from the map itself.

A cell that was never seen is filled when, on a row, a column or a diagonal, data lies on both
sides of it and the gap between is no longer than a given length. Nothing is extrapolated, no cell
that was seen is touched, and cells that are unconfirmed are no data.

How wrong a straight line over a gap is, the map tells: every confirmed cell is taken for missing
in turn, at every pair of distances to both rims, and the errors are squared and averaged. So the
variance grows with the distance from data as fast as this ground makes it grow. Lines that bend
away from the ground at a rim have averages of their own, by how much they bend: where the slope
of the last step to the rim is not that of the line, a crest, a hollow or an edge lies in between.
Where the map has too few examples of a kind, the sharper kind speaks for it, and where there is
none, the gap stays open. The averages contain the noise of the cell that was left out, so they
err on the side of caution.

Cells in the shadow of something nearer (`mapping.change.hidden`) are filled alike but stay
OCCLUDED. There the line is no fair sample: it is the very ray that grazed the rim, and the ground
lies lower. The error learned from open ground is multiplied by what shadows of known grounds
showed; docs/layers.md has the figures.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mapping.cells.elevation_map import CellState, ElevationMap
from mapping.errors import MappingError
from mapping.ground.fill_kernels import Filled, Source, bridge, measure_errors
from mapping.judging.evaluation import CONFIRMED

Float64Array = NDArray[np.float64]

# Fewer errors than this say little of their mean square.
_EXAMPLES_MIN = 30
# Differences of slope (rise per run) at which a sharper kind of bend begins.
_BEND_LIMITS = np.array([0.05, 0.1, 0.2, 0.4, 0.8])
# The time to learn from every pair of distances grows with the square of the gap in cells.
_CELLS_MAX = 64
# How many times larger the errors are in shadows: chosen to hold 98 % within 3 sigma.
_SHADOW_FACTOR = 2.5


def fill_gaps(map_: ElevationMap, up_to_m: float) -> ElevationMap:
    """Return the map with its narrow gaps filled; the same map gives the same bits.

    Filled cells have the state FILLED, or OCCLUDED where the gap is a shadow, no frames, no pixels
    and no stamp; their variance is the
    sum of the noise of the rims (`independent_m2`), the larger `systematic_m2` of both rims and
    the error of a straight line over ground like this map's (`relief_m2`).

    Args:
        map_: the map.
        up_to_m: longest gap that is filled, measured along the line over it.

    Raises:
        MappingError: the length is shorter than a cell or longer than 64.
    """
    missing_max = gap_cells(up_to_m, map_.resolution_m)
    use = np.isin(map_.state, CONFIRMED) & np.isfinite(map_.elevation_m)
    use &= np.isfinite(map_.variance_m2)
    source = Source(
        use, map_.elevation_m, map_.independent_m2, map_.systematic_m2, map_.resolution_m
    )
    filled = Filled(
        np.zeros(use.shape, np.bool_), *(np.zeros(use.shape, np.float32) for _ in range(4))
    )
    error_m2 = _line_error_m2(source, missing_max)
    gaps = np.isin(map_.state, (CellState.UNKNOWN, CellState.OCCLUDED))
    bridge(source, gaps, missing_max, _BEND_LIMITS, error_m2, filled)
    return _with(map_, filled, up_to_m)


def gap_cells(up_to_m: float, edge_m: float) -> NDArray[np.int64]:
    """Return the longest gap in cells along rows and columns, and along diagonals.

    Raises:
        MappingError: the length is shorter than a cell or longer than 64.
    """
    cells = up_to_m / edge_m * (1.0 + 1e-9)
    if not 1.0 <= cells < _CELLS_MAX + 1:
        raise MappingError(
            f"gaps of up to {up_to_m} m cannot be filled; expected one to {_CELLS_MAX} cells, "
            f"{edge_m} to {_CELLS_MAX * edge_m:g} m"
        )
    return np.array([int(cells), int(cells / math.sqrt(2.0))])


def _line_error_m2(source: Source, missing_max: NDArray[np.int64]) -> Float64Array:
    """Return the mean squared error of a straight line; infinite where it is not known.

    Indices: kind of line, cells to the nearer rim, cells to the farther one, class of bend.
    """
    longest = int(missing_max.max()) + 1
    shape = (missing_max.size, longest, longest, _BEND_LIMITS.size + 1)
    squares_m2, counts = np.zeros(shape), np.zeros(shape, np.int64)
    measure_errors(source, missing_max, _BEND_LIMITS, squares_m2, counts)
    enough = counts >= _EXAMPLES_MIN
    error_m2 = np.full(shape, np.inf)
    np.divide(squares_m2, counts, out=error_m2, where=enough)
    for bend in reversed(range(_BEND_LIMITS.size)):
        own, sharper = error_m2[..., bend], error_m2[..., bend + 1]
        np.copyto(own, sharper, where=~enough[..., bend])
    return error_m2


def _with(map_: ElevationMap, filled: Filled, up_to_m: float) -> ElevationMap:
    done, occluded = filled.done, map_.state == CellState.OCCLUDED
    shape_m2 = np.where(occluded, np.float32(_SHADOW_FACTOR**2), np.float32(1.0)) * filled.shape_m2
    parts = (filled.independent_m2, filled.systematic_m2, shape_m2)
    return replace(
        map_,
        elevation_m=np.where(done, filled.height_m, map_.elevation_m),
        variance_m2=np.where(done, parts[0] + parts[1] + parts[2], map_.variance_m2),
        independent_m2=np.where(done, parts[0], map_.independent_m2),
        systematic_m2=np.where(done, parts[1], map_.systematic_m2),
        relief_m2=np.where(done, parts[2], map_.relief_m2),
        state=np.where(done & ~occluded, np.uint8(CellState.FILLED), map_.state),
        attributes={**map_.attributes, "gaps_filled_up_to_m": up_to_m},
    )
