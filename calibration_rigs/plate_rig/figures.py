"""The rig in pictures: analogues of the paper's figures 5 to 10, and what it did not draw."""

from __future__ import annotations

from math import degrees

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from calibration_rigs.plate_rig.cell_result import CellResult, label
from calibration_rigs.plate_rig.process import PlateResult
from calibration_rigs.plate_rig.quantised import BELOW_STEPS
from mapping.output.figure_profile import BLUE, ORANGE

Float64Array = NDArray[np.float64]

_MM = 1000.0
_ENVIRONMENTS = {"indoor": ("o", BLUE), "outdoor": ("s", ORANGE)}
_COLOURS = ("#0072b2", "#009e73", "#e69f00", "#d55e00", "#cc79a7", "#56b4e9")


def bias_figure(result: PlateResult) -> Figure:
    """Show reading minus tape over the distance (the paper's figure 6)."""
    figure, axes = _one_axes()
    for environment, (marker, colour) in _ENVIRONMENTS.items():
        cells = [
            c for c in result.used if c.error_m is not None and c.cell.environment == environment
        ]
        if cells:
            axes.errorbar(
                [c.z_m for c in cells],
                [_MM * (c.error_m or 0.0) for c in cells],
                [_MM * 1.96 * c.error_sigma_m for c in cells],
                fmt=marker,
                color=colour,
                markersize=4,
                linewidth=0.8,
                label=environment,
            )
    z = result.bands.z_m
    mean, sigma = _MM * result.bias.at_m(z), _MM * result.bias.sigma_m(z)
    axes.plot(z, mean, color="black", label="b0 + b1 Z + b2 Z²")
    axes.fill_between(z, mean - 1.96 * sigma, mean + 1.96 * sigma, color="0.85", label="95 %")
    axes.axhline(0.0, color="0.6", linewidth=0.8)
    _finish(axes, "distance [m]", "reading minus tape [mm]", "Systematic error")
    return figure


def noise_figure(result: PlateResult) -> Figure:
    """Show sigma over the distance for each angle (the paper's figures 8 and 10)."""
    figure, axes = _one_axes()
    bands = result.bands
    for colour, angle, mean, low, high in zip(
        _COLOURS, bands.angles_rad, bands.sigma_m, bands.low_m, bands.high_m, strict=False
    ):
        axes.plot(bands.z_m, _MM * mean, color=colour, label=f"law at {degrees(angle):.0f}°")
        axes.fill_between(bands.z_m, _MM * low, _MM * high, color=colour, alpha=0.15, linewidth=0)
    told = [c for c in result.used if not c.spread.is_below]
    below = [c for c in result.used if c.spread.is_below]
    angle = np.array([degrees(c.incidence_rad) for c in told])
    shown = axes.scatter(
        [c.z_m for c in told],
        [_MM * c.sigma_m for c in told],
        c=angle,
        cmap="viridis",
        norm=Normalize(0.0, 75.0),
        s=18,
        zorder=3,
    )
    figure.colorbar(shown, ax=axes, label="incidence [°]")
    for some, marker, colour, text in (
        (below, "v", "0.4", "noise is below this"),
        (result.used, "x", "red", "the paper's column SD"),
    ):
        values = [c.sigma_m if marker == "v" else c.paper.column_sigma_m for c in some]
        if some:
            axes.scatter(
                [c.z_m for c in some],
                _MM * np.array(values),
                marker=marker,
                color=colour,
                s=14,
                linewidth=0.7,
                label=text,
            )
    z = bands.z_m
    step = z**2 * (result.cells[0].step_m / result.cells[0].z_m ** 2)
    axes.plot(z, _MM * step, color="0.5", linestyle=":", label="depth step q")
    axes.set_yscale("log")
    _finish(axes, "distance [m]", "standard deviation [mm]", "Noise without the steps")
    return figure


def deviation_figure(result: PlateResult) -> Figure:
    """Show the readings about the plane in three cells (the paper's figures 7 and 9)."""
    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    cells = _three(result.used)
    for number, cell in enumerate(cells, 1):
        axes = figure.add_subplot(1, len(cells), number)
        found = cell.deviations
        edges_mm, width = _MM * found.edges_m, _MM * float(np.diff(found.edges_m)[0])
        per_mm = 100.0 / found.found.sum() / width
        axes.stairs(per_mm * found.found, edges_mm, fill=True, color=BLUE, alpha=0.5)
        axes.stairs(per_mm * found.expected, edges_mm, color="black", linewidth=0.8)
        plain_mm = _MM * cell.plain_sigma_m
        x = np.linspace(edges_mm[0], edges_mm[-1], 200)
        normal = np.exp(-0.5 * (x / plain_mm) ** 2) / (plain_mm * np.sqrt(2.0 * np.pi))
        axes.plot(x, 100.0 * normal, color="red", linewidth=0.8, linestyle="--")
        axes.set_xlim(-4.0 * plain_mm, 4.0 * plain_mm)
        axes.set_title(label(cell), fontsize=10)
        axes.set_xlabel("deviation [mm]")
    figure.axes[0].set_ylabel("readings [% per mm]")
    return figure


def qq_figure(result: PlateResult) -> Figure:
    """Show quantiles of the readings against those of the quantised normal law."""
    figure, axes = _one_axes()
    for colour, cell in zip(_COLOURS, _three(result.used), strict=False):
        found = cell.deviations
        centres = 0.5 * (found.edges_m[1:] + found.edges_m[:-1]) / cell.step_m
        levels = np.linspace(0.001, 0.999, 400)
        axes.plot(
            _quantiles(found.expected, centres, levels),
            _quantiles(found.found, centres, levels),
            color=colour,
            label=label(cell),
        )
    ends = axes.get_xlim()
    axes.plot(ends, ends, color="0.6", linewidth=0.8)
    _finish(axes, "quantised normal law [steps]", "readings [steps]", "Quantiles")
    return figure


def ratio_figure(result: PlateResult) -> Figure:
    """Show noise over step for all cells; below 0.3 the steps hide it."""
    figure, axes = _one_axes()
    used = result.used
    shown = axes.scatter(
        [c.z_m for c in used],
        [degrees(c.incidence_rad) for c in used],
        c=[c.spread.sigma for c in used],
        cmap="viridis",
        s=300,
        marker="s",
    )
    for cell in used:
        mark = "<" if cell.spread.is_below else ""
        text = f"{mark}{cell.spread.sigma:.2f}"
        place = (cell.z_m, degrees(cell.incidence_rad))
        axes.annotate(
            text, place, ha="center", va="center", fontsize=7, color="white" if not mark else "red"
        )
    figure.colorbar(shown, ax=axes, label="sigma / q")
    axes.set(xlabel="distance [m]", ylabel="incidence [°]")
    axes.set_title(f"Noise in steps (below {BELOW_STEPS:g}: only a bound)", fontsize=11)
    return figure


def residual_figure(result: PlateResult) -> Figure:
    """Show what all plates together are off their planes, pixel by pixel (cf. figure 5)."""
    figure, axes = _one_axes()
    mean = result.distortion.mean_px
    sizes = np.abs(mean[np.isfinite(mean)])
    end = max(float(np.percentile(sizes, 98.0)), 1e-3)
    shown = axes.imshow(mean, cmap="PuOr", vmin=-end, vmax=end, interpolation="nearest")
    figure.colorbar(shown, ax=axes, label="disparity off the plane [px]")
    axes.set(xlabel="column [px]", ylabel="row [px]")
    axes.set_title("Mean residual of all cells", fontsize=11)
    return figure


def _quantiles(counts: Float64Array, centres: Float64Array, levels: Float64Array) -> Float64Array:
    cumulative = np.cumsum(counts) / counts.sum()
    at = np.searchsorted(cumulative, levels)
    quantiles: Float64Array = centres[np.minimum(at, centres.size - 1)]
    return quantiles


def _three(cells: list[CellResult]) -> list[CellResult]:
    """Return the nearest, a middle and the farthest cell, facing the camera as far as possible."""
    facing = sorted(cells, key=lambda c: (c.incidence_rad > np.radians(20.0), c.z_m))
    count = sum(c.incidence_rad <= np.radians(20.0) for c in facing) or len(facing)
    return [facing[k] for k in sorted({0, (count - 1) // 2, count - 1})]


def _one_axes() -> tuple[Figure, Axes]:
    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    return figure, figure.add_subplot()


def _finish(axes: Axes, x: str, y: str, title: str) -> None:
    axes.set(xlabel=x, ylabel=y)
    axes.set_title(title, fontsize=11)
    axes.grid(color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.legend(fontsize=8)
