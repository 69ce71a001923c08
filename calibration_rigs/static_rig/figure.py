"""Allan deviations as a picture."""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from calibration_rigs.errors import RigError
from calibration_rigs.static_rig.allan import AllanCurve, fit_allan
from mapping.files import write_whole


def draw_curves(curves: Mapping[str, AllanCurve], path: Path) -> None:
    """Draw each curve with its 1-sigma band and its fit into one PNG.

    Raises:
        RigError: there is no curve. MappingError: the file cannot be written.
    """
    if not curves:
        raise RigError("no Allan deviation to draw; give a recording at rest (--rest)")
    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    axes = figure.add_subplot()
    for name, curve in curves.items():
        relative = 1.0 / np.sqrt(2.0 * curve.degrees_of_freedom)
        (line,) = axes.loglog(curve.tau_s, curve.deviation, ".", markersize=4, label=name)
        band = (
            curve.deviation * np.maximum(1.0 - relative, 0.05),
            curve.deviation * (1.0 + relative),
        )
        axes.fill_between(curve.tau_s, *band, color=line.get_color(), alpha=0.2, linewidth=0.0)
        axes.loglog(curve.tau_s, fit_allan(curve).deviation(curve.tau_s), color=line.get_color())
    axes.set_xlabel("averaging time [s]")
    axes.set_ylabel("overlapping Allan deviation [rad/s or m/s^2]")
    axes.set_title("Noise at rest: measured (points, 1-sigma band) and fitted (lines)")
    axes.grid(which="both", alpha=0.3)
    axes.legend()
    content = BytesIO()
    figure.savefig(content, format="png", dpi=120)
    write_whole(path, content.getvalue())
