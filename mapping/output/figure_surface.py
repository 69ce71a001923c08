"""A map as a surface between its 3-sigma bounds, seen at an angle."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d.axes3d import Axes3D
from numpy.typing import NDArray

from mapping.cells.elevation_map import ElevationMap
from mapping.output.figure_plan import central_range, confirmed
from mapping.output.figure_profile import BLUE, GREEN, ORANGE, at_cells

# More patches than this along an edge cannot be told apart and take seconds to draw.
_PATCHES_MAX = 60
# Height of the box that is drawn, as a share of its longer edge.
_BOX_HEIGHT = 0.3
_YELLOW = "#F0E442"


def surface_figure(map_: ElevationMap, truth_m: NDArray[np.floating] | None = None) -> Figure:
    """Show confirmed cells between translucent 3-sigma bounds, and the truth as a wire net.

    Cells of large maps are averaged in squares, as the title says; heights are exaggerated.

    Raises:
        MappingError: the truth has another shape.
    """
    edge = math.ceil(max(map_.state.shape) / _PATCHES_MAX)
    x_m, y_m = np.meshgrid(_means(map_.x_m[np.newaxis], edge), _means(map_.y_m[np.newaxis], edge))
    layers = (map_.lower_m, map_.elevation_m, map_.upper_m)
    heights = np.stack([_means(confirmed(map_, layer), edge) for layer in layers])
    low_m, high_m = central_range(heights)
    figure = Figure(figsize=(9.0, 6.5), layout="constrained")
    axes: Axes3D = figure.add_subplot(projection="3d", computed_zorder=False)
    looks = ((BLUE, 0.45, "minus 3 sigma"), (ORANGE, 0.95, "map"), (_YELLOW, 0.3, "plus 3 sigma"))
    # Seen from above, so what is drawn later lies in front.
    for order, (z_m, (colour, alpha, _)) in enumerate(zip(heights, looks, strict=True)):
        axes.plot_surface(
            x_m,
            y_m,
            np.clip(z_m, low_m, high_m),
            color=colour,
            alpha=alpha,
            linewidth=0,
            rstride=1,
            cstride=1,
            zorder=order,
        )
    handles = [Patch(color=colour, alpha=alpha, label=label) for colour, alpha, label in looks]
    if truth_m is not None:
        truth = _means(np.where(np.isfinite(at_cells(map_, truth_m)), truth_m, np.nan), edge)
        truth = np.where(np.isnan(heights[1]), np.nan, np.clip(truth, low_m, high_m))
        axes.plot_wireframe(x_m, y_m, truth, color=GREEN, linewidth=0.5, zorder=len(looks))
        handles.append(Patch(color=GREEN, label="truth"))
    _label(axes, map_, edge, (low_m, high_m))
    axes.legend(handles=handles, fontsize="small", loc="upper left")
    return figure


def _label(axes: Axes3D, map_: ElevationMap, edge: int, limits_m: tuple[float, float]) -> None:
    size_x, size_y = (map_.resolution_m * n for n in map_.state.shape[::-1])
    longest_m = max(size_x, size_y)
    shape = (max(size_x, 0.1 * longest_m), max(size_y, 0.1 * longest_m), _BOX_HEIGHT * longest_m)
    exaggeration = _BOX_HEIGHT * longest_m / (limits_m[1] - limits_m[0])
    squares = f", means of {edge} x {edge} cells" if edge > 1 else ""
    axes.set_title(
        f"Terrain between its 3-sigma bounds\n(confirmed cells{squares}; "
        f"heights {exaggeration:.1f} times exaggerated)",
        fontsize="medium",
    )
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_zlabel("height z [m]")
    axes.set_zlim(*limits_m)
    axes.set_box_aspect(shape, zoom=1.15)
    axes.view_init(elev=32.0, azim=-62.0)


def _means(layer: NDArray[np.floating], edge: int) -> NDArray[np.float64]:
    """Return the means of squares of cells, NaN where a square has no finite cell."""
    rows, columns = layer.shape
    high, wide = min(edge, rows), min(edge, columns)
    padding = ((0, -rows % high), (0, -columns % wide))
    padded = np.pad(layer.astype(np.float64), padding, constant_values=np.nan)
    squares = padded.reshape(padded.shape[0] // high, high, -1, wide)
    count = np.isfinite(squares).sum(axis=(1, 3))
    total = np.nansum(squares, axis=(1, 3))
    means = np.full(count.shape, np.nan)
    np.divide(total, count, out=means, where=count > 0)
    return means
