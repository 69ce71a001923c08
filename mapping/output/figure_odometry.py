"""A trajectory against the true one in pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import chi2

from mapping.files import make_folder, write_whole
from mapping.judging.odometry_scores import OdometryScores
from mapping.output.figure_profile import BLUE, ORANGE
from mapping.output.figures import png_bytes

_NAMES = ("x [mm]", "y [mm]", "z [mm]", "yaw [deg]")
_DOF = 4


def path_figure(scores: OdometryScores) -> Figure:
    """Show both ways from above, after the alignment."""
    figure = Figure(figsize=(7.0, 6.0), layout="constrained")
    axes = figure.add_subplot()
    axes.plot(*scores.true_m[:, :2].T, color=ORANGE, linewidth=2.5, label="true")
    axes.plot(*scores.estimated_m[:, :2].T, color=BLUE, linewidth=1.2, label="estimated")
    axes.plot(*scores.true_m[0, :2], "o", color="black", label="start")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_title(
        f"Seen from above, aligned: {scores.alignment}; ATE {1000 * scores.ate_m.rmse:.0f} mm "
        f"over {scores.metres:.1f} m"
    )
    axes.legend()
    axes.grid(visible=True, alpha=0.3)
    return figure


def drift_figure(scores: OdometryScores) -> Figure:
    """Show the errors since the common start, between the bounds of three sigma, and NEES."""
    judged = bool(np.isfinite(scores.nees_values).any())
    figure = Figure(figsize=(8.0, 9.0 if judged else 7.5), layout="constrained")
    panels = figure.subplots(5 if judged else 4, 1, sharex=True)
    seconds = (scores.t_ns - scores.t_ns[0]) * 1e-9
    units = np.array([1000.0, 1000.0, 1000.0, np.degrees(1.0)])
    for axes, name, error, sigma in zip(
        panels, _NAMES, (scores.error * units).T, (scores.sigma * units).T, strict=False
    ):
        if judged:
            axes.fill_between(
                seconds, -3.0 * sigma, 3.0 * sigma, color=BLUE, alpha=0.2, label="3 sigma"
            )
        axes.plot(seconds, error, color=BLUE, linewidth=1.0, label="error")
        axes.set_ylabel(name)
        axes.grid(visible=True, alpha=0.3)
    if judged:
        axes = panels[-1]
        axes.semilogy(seconds, np.maximum(scores.nees_values, 1e-3), color=BLUE, linewidth=1.0)
        axes.axhline(1.0, color="black", linewidth=0.8, label="honest on average")
        bound = chi2.ppf(0.95, _DOF) / _DOF
        axes.axhline(bound, color=ORANGE, linestyle="--", label="95 % bound")
        axes.set_ylabel("NEES / dof")
        axes.grid(visible=True, alpha=0.3)
        axes.legend(loc="lower right", ncols=2)
    panels[0].legend(loc="upper left", ncols=2)
    panels[0].set_title("Error since the start")
    panels[-1].set_xlabel("time [s]")
    return figure


def write_odometry_figures(scores: OdometryScores, folder: Path) -> list[Path]:
    """Write path.png and drift.png into a folder, which is made where it is missing.

    Raises:
        MappingError: the folder or a file cannot be written.
    """
    make_folder(folder)
    paths = [folder / "path.png", folder / "drift.png"]
    for path, figure in zip(paths, (path_figure(scores), drift_figure(scores)), strict=True):
        write_whole(path, png_bytes(figure))
    return paths
