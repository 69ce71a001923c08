"""Errors and honesty of a map by slope and by range, as bars."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mapping.judging.accuracy import Accuracy
from mapping.judging.evaluation import Parts
from mapping.output.figure_profile import BLUE, GREEN, ORANGE

# What exact normal errors would have within 1 and 3 sigma.
_NORMAL_1SIGMA, _NORMAL_3SIGMA = 0.6827, 0.9973
_BAR_WIDTH = 0.27


def scores_figure(scores: Parts) -> Figure | None:
    """Show size and coverage of the errors, edges apart, by slope and by range.

    Returns:
        None when no class holds a cell.
    """
    groups = {
        "slope of the true terrain": _filled(scores.by_slope),
        "horizontal distance from the rover when last seen": _filled(scores.by_range),
    }
    groups = {name: parts for name, parts in groups.items() if parts}
    if not groups:
        return None
    figure = Figure(figsize=(5.0 * len(groups) + 1.0, 6.4), layout="constrained")
    axes = figure.subplots(2, len(groups), sharey="row", squeeze=False)
    for (sizes, shares), (name, parts) in zip(axes.T, groups.items(), strict=True):
        _draw_sizes(sizes, parts)
        _draw_shares(shares, parts)
        shares.set_xlabel(name)
    axes[0, 0].set_ylabel("error [mm]")
    axes[1, 0].set_ylabel("share of the cells [%]")
    figure.suptitle("Errors by kind of cell, edges apart")
    return figure


def _filled(parts: Mapping[str, Accuracy]) -> dict[str, Accuracy]:
    return {name: part for name, part in parts.items() if part.cells}


def _draw_sizes(axes: Axes, parts: Mapping[str, Accuracy]) -> None:
    series = {
        "RMSE": (BLUE, [part.rmse_m for part in parts.values()]),
        "LE90": (GREEN, [part.le90_m for part in parts.values()]),
        "P99": (ORANGE, [part.p99_m for part in parts.values()]),
    }
    places = np.arange(len(parts))
    for number, (label, (colour, values_m)) in enumerate(series.items(), -1):
        bars = axes.bar(
            places + _BAR_WIDTH * number,
            1000.0 * np.array(values_m),
            _BAR_WIDTH,
            color=colour,
            label=label,
        )
        axes.bar_label(bars, fmt="%.1f", fontsize=7)
    labels = [f"{name}\n{part.cells} cells" for name, part in parts.items()]
    axes.set_xticks(places, labels, fontsize=8)
    axes.legend(fontsize="small", loc="upper left")


def _draw_shares(axes: Axes, parts: Mapping[str, Accuracy]) -> None:
    places = np.arange(len(parts))
    for side, colour, normal, k in (
        (-1, BLUE, _NORMAL_1SIGMA, 1),
        (1, ORANGE, _NORMAL_3SIGMA, 3),
    ):
        shares = [getattr(part, f"coverage_{k}sigma") for part in parts.values()]
        bars = axes.bar(
            places + side * _BAR_WIDTH / 2.0,
            100.0 * np.array(shares),
            _BAR_WIDTH,
            color=colour,
            label=f"within {k} sigma (dashed: {100 * normal:.1f} % for an exact sigma)",
        )
        axes.bar_label(bars, fmt="%.1f", fontsize=7)
        axes.axhline(100.0 * normal, color=colour, lw=1.0, ls="--")
    axes.set_xticks(places, list(parts), fontsize=8)
    axes.set_ylim(0.0, 132.0)  # room for the legend
    axes.set_yticks(range(0, 101, 20))
    axes.legend(fontsize="small", loc="upper left")
