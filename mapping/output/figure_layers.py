"""What the ground is like to drive on, seen from above."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from mapping.cells.elevation_map import ElevationMap
from mapping.ground.layers import derive
from mapping.output.figure_plan import central_range, draw, label_plan

_BREADTH_IN = 5.0
_COLOUR_BAR_IN = 1.6
# Maps this many times wider than high have their panels above each other.
_WIDE = 1.5


def two_plans(map_: ElevationMap) -> tuple[Figure, Axes, Axes]:
    """Return a figure of two plans side by side, or above each other where the map is wide."""
    rows, columns = map_.state.shape
    scale = _BREADTH_IN / max(rows, columns)
    width, height = max(scale * columns, 2.0) + _COLOUR_BAR_IN, max(scale * rows, 2.0) + 1.0
    wide = columns > _WIDE * rows
    figure = Figure(
        figsize=(width, 2.0 * height) if wide else (2.0 * width, height), layout="compressed"
    )
    first, second = figure.subplots(2, 1) if wide else figure.subplots(1, 2)
    return figure, first, second


def layers_figure(map_: ElevationMap) -> Figure:
    """Show slope and traversability."""
    layers = derive(map_)
    slope_deg = np.degrees(layers.slope_rad)
    figure, first, second = two_plans(map_)
    label_plan(first, "Slope\n(grey: not confirmed, or too few neighbours are)")
    steepest = Normalize(0.0, max(central_range(slope_deg)[1], 1.0))
    draw(first, map_, slope_deg, "viridis", steepest, "slope [deg]", extend="max")
    label_plan(second, "Traversability\n(worst of slope, roughness and step; 0 = beyond a limit)")
    draw(
        second,
        map_,
        layers.traversability,
        "viridis",
        Normalize(0.0, 1.0),
        "traversability",
        extend="neither",
    )
    return figure
