"""A vertical cut through a map: heights, their 3-sigma band, and the truth."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mapping.cells.elevation_map import ElevationMap
from mapping.errors import MappingError
from mapping.judging.evaluation import CONFIRMED

BLUE, ORANGE, GREEN = "#0072B2", "#D55E00", "#009E73"  # Okabe and Ito
Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Section:
    """A straight line over the map from one (x, y) to another, in metres."""

    start_m: Point
    end_m: Point

    @property
    def length_m(self) -> float:
        """Its length."""
        return math.dist(self.start_m, self.end_m)


def longest_section(map_: ElevationMap) -> Section:
    """Return the row or column of cells with the most confirmed cells.

    Raises:
        MappingError: no cell is confirmed.
    """
    known = np.isin(map_.state, CONFIRMED)
    if not known.any():
        raise MappingError(
            "no cell of the map is confirmed, so there is nothing to draw; record for longer or "
            "lower confirmed_frames and confirmed_pixels"
        )
    in_rows, in_columns = known.sum(axis=1), known.sum(axis=0)
    if in_rows.max() >= in_columns.max():
        y_m = float(map_.y_m[in_rows.argmax()])
        return Section((float(map_.x_m[0]), y_m), (float(map_.x_m[-1]), y_m))
    x_m = float(map_.x_m[in_columns.argmax()])
    return Section((x_m, float(map_.y_m[0])), (x_m, float(map_.y_m[-1])))


def profile_figure(
    map_: ElevationMap, section: Section, truth_m: NDArray[np.floating] | None = None
) -> Figure:
    """Show the heights of confirmed cells along a line, with their 3-sigma band.

    Raises:
        MappingError: the line meets no confirmed cell, or the truth has another shape.
    """
    along_m, rows, columns = _cells_along(map_, section)
    known = np.isin(map_.state[rows, columns], CONFIRMED)
    if not known.any():
        raise MappingError(
            f"the profile from {section.start_m} to {section.end_m} m meets no confirmed cell; "
            "choose a line over the map"
        )
    figure = Figure(figsize=(9.0, 4.2), layout="constrained")
    axes = figure.add_subplot()
    height, lower, upper = (
        np.where(known, layer[rows, columns], np.nan)
        for layer in (map_.elevation_m, map_.lower_m, map_.upper_m)
    )
    axes.fill_between(along_m, lower, upper, color=BLUE, alpha=0.25, lw=0, label="3-sigma band")
    axes.plot(along_m, height, color=BLUE, marker=".", markersize=3, lw=1.2, label="map")
    if truth_m is not None:
        true = at_cells(map_, truth_m)[rows, columns]
        axes.plot(along_m, true, color=ORANGE, lw=1.2, ls="--", label="truth")
        outside = known & ((true < lower) | (true > upper))
        if outside.any():
            axes.plot(along_m[outside], true[outside], "x", color="black", label="truth outside")
    (x0, y0), (x1, y1) = section.start_m, section.end_m
    axes.set_title(f"Profile from ({x0:.2f}, {y0:.2f}) m to ({x1:.2f}, {y1:.2f}) m")
    axes.set_xlabel("distance along the profile [m]")
    axes.set_ylabel("height z [m]")
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")
    return figure


def at_cells(map_: ElevationMap, truth_m: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return the true heights if they are given for the map's cells.

    Raises:
        MappingError: they have another shape.
    """
    if truth_m.shape != map_.state.shape:
        raise MappingError(
            f"the truth has shape {truth_m.shape} and the map {map_.state.shape}; "
            "give the heights at the map's cells"
        )
    return truth_m


def _cells_along(
    map_: ElevationMap, section: Section
) -> tuple[NDArray[np.float64], NDArray[np.intp], NDArray[np.intp]]:
    """Return the cells that a line meets, each once: distance along it, row and column."""
    steps = 2 * math.ceil(section.length_m / map_.resolution_m) + 1
    share = np.linspace(0.0, 1.0, steps)
    (x0, y0), (x1, y1) = section.start_m, section.end_m
    columns = np.rint((x0 + share * (x1 - x0) - map_.x_m[0]) / map_.resolution_m).astype(np.intp)
    rows = np.rint((y0 + share * (y1 - y0) - map_.y_m[0]) / map_.resolution_m).astype(np.intp)
    use = (rows >= 0) & (rows < map_.y_m.size) & (columns >= 0) & (columns < map_.x_m.size)
    use[1:] &= (np.diff(rows) != 0) | (np.diff(columns) != 0)
    rows, columns = rows[use], columns[use]
    ahead = (map_.x_m[columns] - x0) * (x1 - x0) + (map_.y_m[rows] - y0) * (y1 - y0)
    return ahead / max(section.length_m, map_.resolution_m), rows, columns
