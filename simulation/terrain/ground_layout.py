"""Where a ground lies: its extent as a grid, and the level place where a drive begins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulation.errors import SimulationError

Float64Array = NDArray[np.float64]

# x_min, x_max, y_min, y_max in metres.
Extent = tuple[float, float, float, float]

_MOST_NODES = 25_000_000


@dataclass(frozen=True, slots=True)
class FlatStart:
    """A level disc that the ground blends into; the ground's height there becomes zero.

    Attributes:
        x_m, y_m: its centre.
        radius_m: level out to here.
        blend_m: untouched from this much further out.
    """

    x_m: float = 0.0
    y_m: float = 0.0
    radius_m: float = 0.8
    blend_m: float = 1.0

    def __post_init__(self) -> None:
        """Refuse what is no disc."""
        if not (self.radius_m >= 0.0 and self.blend_m > 0.0):
            raise SimulationError(
                f"a level start of {self.radius_m} m, blended over {self.blend_m} m; expected 0 or "
                "more, and more than 0"
            )


FLAT_START = FlatStart()


def grid_shape(extent: Extent, spacing_m: float) -> tuple[int, int]:
    """Return the rows and columns of a grid over an extent, rounded to whole squares.

    Raises:
        SimulationError: not an extent, or too few or too many nodes.
    """
    x_min, x_max, y_min, y_max = extent
    if not (np.isfinite(extent).all() and spacing_m > 0.0 and x_max > x_min and y_max > y_min):
        raise SimulationError(
            f"a terrain over {extent} m with nodes every {spacing_m} m; expected "
            "x_min < x_max, y_min < y_max and a positive spacing"
        )
    columns, rows = ((x_max - x_min) / spacing_m, (y_max - y_min) / spacing_m)
    if min(columns, rows) < 1.0 or (columns + 1.0) * (rows + 1.0) > _MOST_NODES:
        raise SimulationError(
            f"a terrain of {columns:.0f} x {rows:.0f} squares; expected at least 1 x 1 and at "
            f"most {_MOST_NODES} nodes: choose another extent or spacing"
        )
    return round(rows) + 1, round(columns) + 1


def level_start(heights: Float64Array, extent: Extent, spacing_m: float, start: FlatStart) -> None:
    """Blend the ground into the start, in place, and make the start's height zero."""
    rows, columns = heights.shape
    x = extent[0] + spacing_m * np.arange(columns, dtype=np.float64) - start.x_m
    y = extent[2] + spacing_m * np.arange(rows, dtype=np.float64) - start.y_m
    away = (np.hypot(x, y[:, np.newaxis]) - start.radius_m) / start.blend_m
    inside = away <= 0.0
    if inside.any():
        heights -= heights[inside].mean()
    t = np.clip(away, 0.0, 1.0)
    heights *= t * t * (3.0 - 2.0 * t)
