"""A map of a real laboratory: a flat floor at a known height, perhaps with one box on it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from mapping.cells.elevation_map import CellState, ElevationMap
from mapping.errors import MappingError
from mapping.files import read_whole
from mapping.judging.accuracy import (
    BoolArray,
    Float64Array,
    Json,
    anees,
    coverage,
    finite_or_none,
    mad_sigma,
    sigma_classes,
)
from mapping.judging.evaluation import CONFIRMED

# Cells nearer to the box's walls than this hold both floor and wall: pose and lateral noise.
_CLEARANCE_M = 0.15
_TOP_MARGIN_M = 0.06
# The floor that a walk around the box sees from all sides; farther cells are seen at a distance
# and from one side, where a crooked mount does not cancel.
_AROUND_BOX_M = 0.5
# Confirmed cells farther from the floor's height are things that stand on it, not floor.
_FLOOR_WINDOW_M = 0.10


@dataclass(frozen=True, slots=True)
class Box:
    """A box in the terrain frame; lengths from its centre along its own axes.

    Attributes:
        x_m, y_m, z_m: centre.
        yaw_rad: turn of its length axis from x about z.
        half_length_m, half_width_m, half_height_m: half of its edges.
    """

    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float
    half_length_m: float
    half_width_m: float
    half_height_m: float

    @property
    def top_m(self) -> float:
        """Height of its upper face."""
        return self.z_m + self.half_height_m

    def footprint(self, map_: ElevationMap, enlarged_m: float) -> BoolArray:
        """Return the map's cells whose centre is within the footprint, enlarged on all sides."""
        dx, dy = np.meshgrid(map_.x_m - self.x_m, map_.y_m - self.y_m)
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        along: BoolArray = np.abs(cos * dx + sin * dy) <= self.half_length_m + enlarged_m
        return along & (np.abs(cos * dy - sin * dx) <= self.half_width_m + enlarged_m)


def read_box(path: Path) -> Box:
    """Read a box from a text file: `x y z yaw half-length half-width half-height` (m, rad).

    Raises:
        MappingError: the file cannot be read or does not hold these seven numbers.
    """
    words = read_whole(path).decode("utf-8", "replace").split()
    try:
        box = Box(*(float(word) for word in words))
    except (ValueError, TypeError):
        box = None
    if box is None or not _is_box(box):
        raise MappingError(
            f"{path} is no box: expected seven numbers, x y z yaw half-length half-width "
            "half-height in metres and radians, the last three above 0"
        )
    return box


@dataclass(frozen=True, slots=True)
class FloorAccuracy:
    """Floor cells of one kind; numbers of an empty set are NaN.

    Attributes:
        cells: how many.
        median_m: median height above the floor's true height.
        mad_sigma_m: 1.4826 * median absolute deviation from that median.
        coverage_1sigma, coverage_3sigma: share with |height - true height| <= k sigma.
        anees: mean of ((height - true height) / sigma)^2.
    """

    cells: int
    median_m: float
    mad_sigma_m: float
    coverage_1sigma: float
    coverage_3sigma: float
    anees: float

    def as_json(self) -> Json:
        """Return the numbers by name; those that are not finite as None."""
        return {name: finite_or_none(value) for name, value in asdict(self).items()}


@dataclass(frozen=True, slots=True)
class FloorScores:
    """How a map renders a flat floor and the top of a box.

    Attributes:
        floor: by kind of cell: "confirmed", "measured", "around the box" (within 0.5 m of it), and
            classes of sigma.
        not_floor_cells: confirmed cells clear of the box, but more than 0.10 m off the floor.
        box_cells: confirmed cells on the box's top, 0.06 m or more from its edges.
        box_top_m, box_top_true_m: their median height and the true one; NaN without box or cells.
    """

    floor: Mapping[str, FloorAccuracy]
    not_floor_cells: int
    box_cells: int
    box_top_m: float
    box_top_true_m: float

    def as_json(self) -> Json:
        """Return all numbers by name; those that are not finite as None."""
        return {
            "floor": {name: part.as_json() for name, part in self.floor.items()},
            "not_floor_cells": self.not_floor_cells,
            "box_cells": self.box_cells,
            "box_top_m": finite_or_none(self.box_top_m),
            "box_top_true_m": finite_or_none(self.box_top_true_m),
        }

    def describe(self) -> list[str]:
        """Return the scores as lines of text."""
        heading = (
            f"{'floor':<16}{'cells':>9}{'median':>10}{'MAD sig':>10}{'1 sig':>8}{'3 sig':>8}"
            f"{'ANEES':>9}"
        )
        units = f"{'':<25}{'mm':>10}{'mm':>10}{'%':>8}{'%':>8}"
        lines = [heading, units, *(_line(name, part) for name, part in self.floor.items())]
        lines.append(f"confirmed cells that are not floor: {self.not_floor_cells}")
        if self.box_cells:
            lines.append(
                f"box top: median {self.box_top_m:.4f} m in {self.box_cells} cells, "
                f"true {self.box_top_true_m:.4f} m"
            )
        return lines


def evaluate_floor(
    map_: ElevationMap, floor_height_m: float = 0.0, box: Box | None = None
) -> FloorScores:
    """Judge a map by the flat floor that it shows.

    Floor cells are confirmed, at least 0.15 m clear of the box, and within 0.10 m of the floor.

    Raises:
        MappingError: there is no floor cell.
    """
    confirmed = np.isin(map_.state, CONFIRMED)
    clear = confirmed if box is None else confirmed & ~box.footprint(map_, _CLEARANCE_M)
    error = map_.elevation_m.astype(np.float64) - floor_height_m
    floor = clear & (np.abs(error) <= _FLOOR_WINDOW_M)
    if not floor.any():
        raise MappingError(
            f"no confirmed cell lies within {_FLOOR_WINDOW_M} m of the floor at "
            f"{floor_height_m} m; check the floor's height and the frame of the map"
        )
    sigma = map_.sigma_m.astype(np.float64)
    groups = {"confirmed": floor, "measured": floor & (map_.state == CellState.MEASURED)}
    if box is not None:
        groups["around the box"] = floor & box.footprint(map_, _AROUND_BOX_M)
    groups |= {f"sigma {name}": floor & cells for name, cells in sigma_classes(sigma).items()}
    top = map_.elevation_m[confirmed & box.footprint(map_, -_TOP_MARGIN_M)] if box else np.empty(0)
    return FloorScores(
        floor={name: _floor_accuracy(error[c], sigma[c]) for name, c in groups.items()},
        not_floor_cells=int(np.count_nonzero(clear & ~floor)),
        box_cells=int(top.size),
        box_top_m=float(np.median(top)) if top.size else math.nan,
        box_top_true_m=box.top_m if box else math.nan,
    )


def _floor_accuracy(error_m: Float64Array, sigma_m: Float64Array) -> FloorAccuracy:
    if error_m.size == 0:
        return FloorAccuracy(0, *[math.nan] * 5)
    return FloorAccuracy(
        cells=int(error_m.size),
        median_m=float(np.median(error_m)),
        mad_sigma_m=mad_sigma(error_m),
        coverage_1sigma=coverage(error_m, sigma_m, 1),
        coverage_3sigma=coverage(error_m, sigma_m, 3),
        anees=anees(error_m, sigma_m),
    )


def _is_box(box: Box) -> bool:
    numbers = (box.x_m, box.y_m, box.z_m, box.yaw_rad)
    halves = (box.half_length_m, box.half_width_m, box.half_height_m)
    return all(map(math.isfinite, numbers)) and all(0.0 < half < math.inf for half in halves)


def _line(name: str, part: FloorAccuracy) -> str:
    if part.cells == 0:
        return f"{name:<16}{0:>9}"
    lengths_m = (part.median_m, part.mad_sigma_m)
    shares = (part.coverage_1sigma, part.coverage_3sigma)
    return (
        f"{name:<16}{part.cells:>9}"
        + "".join(f"{1000.0 * length:>10.2f}" for length in lengths_m)
        + "".join(f"{100.0 * share:>8.1f}" for share in shares)
        + f"{part.anees:>9.2f}"
    )
