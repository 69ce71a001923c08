"""All pictures of a map as PNG files.

Every figure is a matplotlib `Figure` of its own; nothing global is touched, so figures may be
made in any thread and leave nothing behind.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mapping.cells.elevation_map import ElevationMap
from mapping.files import make_folder, write_whole
from mapping.judging.evaluation import Scores
from mapping.output.figure_errors import consistency_figure, error_figure
from mapping.output.figure_fused import fused_figure
from mapping.output.figure_layers import layers_figure
from mapping.output.figure_plan import height_figure, sigma_figure, state_figure
from mapping.output.figure_profile import longest_section, profile_figure
from mapping.output.figure_scores import scores_figure
from mapping.output.figure_surface import surface_figure

_DPI = 130


def write_figures(
    map_: ElevationMap,
    folder: Path,
    truth_m: NDArray[np.floating] | None = None,
    scores: Scores | None = None,
) -> list[Path]:
    """Write all figures of a map as PNG files into a folder, which is made where it is missing.

    Args:
        map_: the map.
        folder: gets height.png, sigma.png, state.png, layers.png, fused.png, profile.png,
            surface.png and, with a truth, error.png and consistency.png; with scores, scores.png.
        truth_m: true heights at the cell centres, NaN = none.
        scores: the map's.

    Raises:
        MappingError: no cell is confirmed, the truth has another shape or none of its heights
            stands beside a confirmed cell, or a file cannot be written.
    """
    section = longest_section(map_)
    figures = {
        "height": height_figure(map_, section),
        "sigma": sigma_figure(map_),
        "state": state_figure(map_),
        "layers": layers_figure(map_),
        "fused": fused_figure(map_),
        "profile": profile_figure(map_, section, truth_m),
        "surface": surface_figure(map_, truth_m),
    }
    if truth_m is not None:
        figures["error"] = error_figure(map_, truth_m)
        figures["consistency"] = consistency_figure(map_, truth_m)
    by_class = None if scores is None else scores_figure(scores)
    if by_class is not None:
        figures["scores"] = by_class
    make_folder(folder)
    paths = {name: folder / f"{name}.png" for name in figures}
    for name, path in paths.items():
        write_whole(path, png_bytes(figures[name]))
    return list(paths.values())


def png_bytes(figure: Figure) -> bytes:
    """Return a figure as a PNG file."""
    buffer = io.BytesIO()
    FigureCanvasAgg(figure)
    # matplotlib projects the corners that a patch beside a gap lacks, from memory that nobody
    # filled, before it leaves them out; some such numbers overflow.
    with np.errstate(over="ignore", invalid="ignore"):
        figure.savefig(buffer, format="png", dpi=_DPI)
    return buffer.getvalue()
