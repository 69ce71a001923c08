"""A map seen from above: height, standard deviation, state."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import BoundaryNorm, ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mapping.cells.elevation_map import CellState, ElevationMap
from mapping.judging.evaluation import CONFIRMED
from mapping.output.figure_profile import Section

_GREY = "0.85"
# Okabe and Ito's colours, told apart by colour-blind readers.
_STATE_COLOURS = {
    CellState.UNKNOWN: _GREY,
    CellState.UNCONFIRMED: "#D55E00",
    CellState.MEASURED: "#0072B2",
    CellState.UNCERTAIN: "#F0E442",
    CellState.FILLED: "#CC79A7",
    CellState.OCCLUDED: "0.3",
}
_SIGMA_TICKS_MM = np.array([0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000])
# Colours span this share of the values, so that one flying pixel does not flatten the rest.
_CENTRAL_PERCENT = (0.5, 99.5)
_LENGTH_IN = 6.0
_BREADTH_MIN_IN = 2.0


def height_figure(map_: ElevationMap, section: Section | None = None) -> Figure:
    """Show the heights of confirmed cells, and where a profile runs."""
    heights = confirmed(map_, map_.elevation_m)
    low, high = central_range(heights)
    figure, axes = plan(map_, "Height of the terrain\n(grey: not confirmed)")
    draw(axes, map_, heights, "cividis", Normalize(low, high), "height z [m]")
    if section is not None:
        x_m, y_m = zip(section.start_m, section.end_m, strict=True)
        axes.plot(x_m, y_m, color="white", linewidth=3.0)
        axes.plot(x_m, y_m, color="black", linewidth=1.2, label="profile")
        axes.legend(loc="upper right", fontsize="small")
    return figure


def sigma_figure(map_: ElevationMap) -> Figure:
    """Show the standard deviations of confirmed cells on a logarithmic scale."""
    sigma_mm = 1000.0 * confirmed(map_, map_.sigma_m)
    low, high = central_range(np.where(sigma_mm > 0.0, sigma_mm, np.nan))
    # From labelled tick to labelled tick, so that a uniform map has a scale too.
    first = int(np.clip(np.searchsorted(_SIGMA_TICKS_MM, low, "right") - 1, 0, 11))
    last = int(np.clip(np.searchsorted(_SIGMA_TICKS_MM, high), first + 1, 12))
    ticks = _SIGMA_TICKS_MM[first : last + 1]
    figure, axes = plan(map_, "Standard deviation of the height\n(grey: not confirmed)")
    bar = draw(axes, map_, sigma_mm, "viridis", LogNorm(ticks[0], ticks[-1]), "sigma [mm]")
    bar.set_ticks(list(ticks), labels=[f"{tick:g}" for tick in ticks])
    bar.ax.minorticks_off()
    return figure


def state_figure(map_: ElevationMap) -> Figure:
    """Show the state of every cell and how many cells have it."""
    figure, axes = plan(map_, "What is known of each cell")
    colours = ListedColormap([_STATE_COLOURS[state] for state in CellState])
    norm = BoundaryNorm(np.arange(len(CellState) + 1) - 0.5, len(CellState))
    bar = draw(axes, map_, map_.state.astype(np.float32), colours, norm, "", extend="neither")
    counts = [np.count_nonzero(map_.state == state) for state in CellState]
    labels = [f"{s.name.lower()}\n{n} cells" for s, n in zip(CellState, counts, strict=True)]
    bar.set_ticks([state.value for state in CellState], labels=labels)
    bar.ax.minorticks_off()
    return figure


def confirmed(map_: ElevationMap, layer: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return a layer with NaN in all cells that are not confirmed."""
    return np.where(np.isin(map_.state, CONFIRMED), layer, np.nan)


def central_range(values: NDArray[np.floating]) -> tuple[float, float]:
    """Return the range that holds 99 % of the finite values; never empty."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return 0.0, 1.0
    low, high = np.percentile(finite, _CENTRAL_PERCENT)
    return (float(low), float(high)) if high > low else (float(low) - 1e-3, float(high) + 1e-3)


def plan(map_: ElevationMap, title: str) -> tuple[Figure, Axes]:
    """Return a figure whose shape suits the map, with labelled axes of equal scale."""
    rows, columns = map_.state.shape
    scale = _LENGTH_IN / max(rows, columns)
    size = (max(scale * columns, _BREADTH_MIN_IN) + 1.8, max(scale * rows, _BREADTH_MIN_IN) + 0.8)
    # "constrained" does not know of the equal scales, and cuts what stands beside a long map.
    figure = Figure(figsize=size, layout="compressed")
    axes = figure.add_subplot()
    label_plan(axes, title)
    return figure, axes


def label_plan(axes: Axes, title: str) -> None:
    """Give the axes of a plan their words and their ground."""
    axes.set_title(title, fontsize="medium")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_facecolor(_GREY)


def draw(
    axes: Axes,
    map_: ElevationMap,
    values: NDArray[np.floating],
    colours: str | ListedColormap,
    norm: Normalize,
    label: str,
    extend: str = "both",
) -> Colorbar:
    """Draw a layer at its place and give it a colour bar."""
    half_m = 0.5 * map_.resolution_m
    place = (
        map_.x_m[0] - half_m,
        map_.x_m[-1] + half_m,
        map_.y_m[0] - half_m,
        map_.y_m[-1] + half_m,
    )
    picture: ScalarMappable = axes.imshow(
        values,
        cmap=colours,
        norm=norm,
        extent=place,
        origin="lower",
        aspect="equal",
        interpolation="nearest",
    )
    return axes.figure.colorbar(picture, ax=axes, label=label, extend=extend, shrink=0.9)
