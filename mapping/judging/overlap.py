"""Whether a map and a truth are of one place, and how much of the map the truth can judge."""

from __future__ import annotations

import numpy as np

from mapping.cells.elevation_map import ElevationMap
from mapping.errors import MappingError
from mapping.judging.accuracy import Float64Array
from mapping.judging.evaluation import counted_cells
from mapping.judging.truth import Truth

# Of fewer cells, a share such as the coverage is known no better than to several percent.
_FEW_CELLS = 100


def overlap_warning(map_: ElevationMap, truth: Truth) -> str:
    """Return what is to be said of scores that few cells, or the lesser part of them, make; or "".

    Raises:
        MappingError: none of the confirmed cells has a truth; says where both of them lie.
    """
    confirmed = counted_cells(map_)
    total = int(confirmed.sum())
    judged = int((confirmed & np.isfinite(truth.truth_at(map_).height_m)).sum())
    if total and not judged:
        raise MappingError(
            f"the truth is of another place: the map lies at {_extent(map_.x_m, map_.y_m)}, the "
            f"truth at {_extent(truth.x_m, truth.y_m)}, and none of the map's {total} confirmed "
            "cells has a true height; give the truth of the map's own run, in its frame"
        )
    of_another_place = 2 * judged < total
    if judged >= _FEW_CELLS and not of_another_place:
        return ""
    line = f"the scores are of {judged} of the map's {total} confirmed cells alone"
    return f"{line}; the truth may be of another place" if of_another_place else line


def _extent(x_m: Float64Array, y_m: Float64Array) -> str:
    return f"x {x_m[0]:.1f} to {x_m[-1]:.1f}, y {y_m[0]:.1f} to {y_m[-1]:.1f} m"
