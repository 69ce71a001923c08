"""What the errors of a cell's place make of the heights, seen from above."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from mapping.cells.elevation_map import ElevationMap
from mapping.ground.fusion import fuse_map
from mapping.output.figure_layers import two_plans
from mapping.output.figure_plan import central_range, draw, label_plan


def fused_figure(map_: ElevationMap) -> Figure:
    """Show the fused standard deviation and the height of the band between the fused bounds."""
    fused = fuse_map(map_)
    figure, first, second = two_plans(map_)
    sigma_mm = 1000.0 * np.sqrt(fused.variance_m2)
    label_plan(first, "Fused standard deviation\n(errors of height and of place)")
    largest = Normalize(0.0, max(central_range(sigma_mm)[1], 0.1))
    draw(first, map_, sigma_mm, "viridis", largest, "sigma [mm]", extend="max")
    band_mm = 1000.0 * (fused.upper_m - fused.lower_m)
    label_plan(second, "Between the fused bounds\n(errors of height and of place)")
    widest = Normalize(0.0, max(central_range(band_mm)[1], 0.1))
    draw(second, map_, band_mm, "viridis", widest, "upper - lower [mm]", extend="max")
    return figure
