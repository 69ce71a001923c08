"""A map against the truth in pictures: the errors in plan, and whether sigma foretold them."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mapping.cells.elevation_map import ElevationMap
from mapping.errors import MappingError
from mapping.judging.accuracy import accuracy
from mapping.output.figure_plan import confirmed, draw, plan
from mapping.output.figure_profile import BLUE, ORANGE, at_cells

_HISTOGRAM_END = 5.0
_HISTOGRAM_BINS = 50


def error_figure(map_: ElevationMap, truth_m: NDArray[np.floating]) -> Figure:
    """Show height minus truth of confirmed cells in plan.

    Raises:
        MappingError: see `consistency_figure`.
    """
    error_mm = 1000.0 * _errors_m(map_, truth_m)
    sizes = np.abs(error_mm[np.isfinite(error_mm)])
    end = max(float(np.percentile(sizes, 99.0)), 0.1)
    figure, axes = plan(map_, "Error: map minus truth\n(grey: no confirmed height or no truth)")
    draw(axes, map_, error_mm, "PuOr", Normalize(-end, end), "error [mm]")
    return figure


def consistency_figure(map_: ElevationMap, truth_m: NDArray[np.floating]) -> Figure:
    """Show the histogram of error / sigma of confirmed cells against the unit normal law.

    Raises:
        MappingError: the truth has another shape, or none beside a confirmed cell.
    """
    error_m = _errors_m(map_, truth_m)
    cells = np.isfinite(error_m)
    sigma_m = map_.sigma_m[cells].astype(np.float64)
    found = accuracy(error_m[cells], sigma_m)
    ratio = np.divide(error_m[cells], sigma_m, out=np.zeros(sigma_m.size), where=sigma_m > 0.0)
    edges = np.linspace(-_HISTOGRAM_END, _HISTOGRAM_END, _HISTOGRAM_BINS + 1)
    # The outermost bins hold what lies beyond them: nothing is left out of sight.
    counts, _ = np.histogram(np.clip(ratio, edges[0], edges[-1]), edges)
    figure = Figure(figsize=(8.0, 4.5), layout="constrained")
    axes = figure.add_subplot()
    density = counts / (ratio.size * np.diff(edges))
    axes.stairs(
        density, edges, fill=True, color=BLUE, alpha=0.6, label="confirmed cells, edges included"
    )
    z = np.linspace(edges[0], edges[-1], 400)
    normal = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
    axes.plot(z, normal, color=ORANGE, label="unit normal law: an exact sigma")
    axes.set_title(
        f"Errors in units of their sigma: {100 * found.coverage_1sigma:.1f} % within 1, "
        f"{100 * found.coverage_3sigma:.1f} % within 3, ANEES {found.anees:.2f}"
    )
    axes.set_xlabel("error / sigma [1] (outermost bars: all beyond)")
    axes.set_ylabel("probability density [1]")
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")
    return figure


def _errors_m(map_: ElevationMap, truth_m: NDArray[np.floating]) -> NDArray[np.float64]:
    error_m = confirmed(map_, map_.elevation_m.astype(np.float64)) - at_cells(map_, truth_m)
    if not np.isfinite(error_m).any():
        raise MappingError("no confirmed cell of the map has a true height beside it")
    return np.asarray(error_m, np.float64)
