"""A map against the true terrain: errors, coverage of its sigma, completeness."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from mapping.cells.elevation_map import CellState, ElevationMap
from mapping.errors import MappingError
from mapping.judging.accuracy import (
    Accuracy,
    BoolArray,
    Float64Array,
    Json,
    accuracy,
    classes,
    finite_or_none,
    sigma_classes,
    table,
)

CONFIRMED = (CellState.MEASURED, CellState.UNCERTAIN)
# A step between neighbours that is higher than this share of a cell's edge (50 degrees) is an
# edge: the cell holds two surfaces, and no single height is its true one.
EDGE_STEP_PER_CELL = 1.2
# Upper ends of the classes of slope, in degrees; the last class has none.
SLOPE_CLASSES_DEG = (5.0, 10.0, 20.0, 30.0)


@dataclass(frozen=True, slots=True)
class Scores(Accuracy):
    """The numbers of all counted cells, edges apart, and of parts of them.

    Attributes:
        completeness: share of the visible cells of the truth that are counted or an edge.
        by_slope, by_sigma: the same numbers by slope of the truth and by claimed sigma.
        edges: counted cells whose truth steps to a neighbour.
        unconfirmed: cells seen too seldom to be counted; they may hold flying pixels.
    """

    completeness: float
    by_slope: Mapping[str, Accuracy]
    by_sigma: Mapping[str, Accuracy]
    edges: Accuracy
    unconfirmed: Accuracy

    def as_json(self) -> Json:
        """Return all numbers by name; those that are not finite as None."""
        return {
            **Accuracy.as_json(_overall(self)),
            "completeness": finite_or_none(self.completeness),
            "by_slope": {name: part.as_json() for name, part in self.by_slope.items()},
            "by_sigma": {name: part.as_json() for name, part in self.by_sigma.items()},
            "edges": self.edges.as_json(),
            "unconfirmed": self.unconfirmed.as_json(),
        }

    def rows(self) -> dict[str, Accuracy]:
        """Return every set of cells under the name it has in a table."""
        return {
            "all": _overall(self),
            **{f"slope {name}": part for name, part in self.by_slope.items()},
            **{f"sigma {name}": part for name, part in self.by_sigma.items()},
            "edges": self.edges,
            "unconfirmed": self.unconfirmed,
        }

    def lines(self) -> list[str]:
        """Return the scores as lines of text."""
        return [*table(self.rows()), f"completeness {100.0 * self.completeness:.1f} %"]


def evaluate(
    map_: ElevationMap,
    truth_m: NDArray[np.floating],
    visible: BoolArray | None = None,
    *,
    visible_outside: float = 0.0,
    states: tuple[CellState, ...] = CONFIRMED,
    edge_step_m: float | None = None,
) -> Scores:
    """Compare a map with the truth at its cells.

    Args:
        map_: the map.
        truth_m: true heights at the cell centres, shape of the map's layers, NaN = no truth.
        visible: cells that the sensor could see; all cells with a truth when left out.
        visible_outside: visible cells of the truth beyond the map's rectangle; they lower the
            completeness.
        states: states of the cells that count.
        edge_step_m: a cell whose truth differs by more from one of its four neighbours is an
            edge; 1.2 cell edges when left out.

    Raises:
        MappingError: shapes differ, or no counted cell has a truth.
    """
    truth = _checked(map_, truth_m, visible)
    has_truth = np.isfinite(truth)
    counted = np.isin(map_.state, states) & map_.known & has_truth
    step_m = EDGE_STEP_PER_CELL * map_.resolution_m if edge_step_m is None else edge_step_m
    edge = edge_cells(truth, step_m)
    smooth = counted & ~edge
    if not smooth.any():
        raise MappingError(
            "no confirmed cell of the map has a true height beside it; check that map and truth "
            "are in the same frame and overlap"
        )
    error = map_.elevation_m - truth
    sigma = map_.sigma_m.astype(np.float64)
    slope_deg = np.degrees(slope_rad(truth, map_.resolution_m))

    def of(cells: BoolArray) -> Accuracy:
        return accuracy(error[cells], sigma[cells])

    by_slope = classes(slope_deg, SLOPE_CLASSES_DEG, "deg")
    visible_cells = has_truth if visible is None else visible & has_truth
    return Scores(
        **asdict(of(smooth)),
        completeness=_share(counted & visible_cells, visible_cells, visible_outside),
        by_slope={name: of(smooth & cells) for name, cells in by_slope.items()},
        by_sigma={name: of(smooth & cells) for name, cells in sigma_classes(sigma).items()},
        edges=of(counted & edge),
        unconfirmed=of((map_.state == CellState.UNCONFIRMED) & has_truth),
    )


def edge_cells(truth_m: Float64Array, step_m: float) -> BoolArray:
    """Return the cells whose height differs by more than `step_m` from one of four neighbours."""
    steps = np.concatenate([_steps(truth_m, 0), _steps(truth_m, 1)])
    edge: BoolArray = np.any(np.abs(steps) > step_m, axis=0)
    return edge


def slope_rad(truth_m: Float64Array, resolution_m: float) -> Float64Array:
    """Return the slope of a surface: central differences, one-sided beside NaN, else NaN."""
    squared = np.zeros(truth_m.shape)
    for axis in (0, 1):
        steps = _steps(truth_m, axis) / resolution_m
        sides = np.isfinite(steps).sum(axis=0)
        gradient = np.full(truth_m.shape, np.nan)
        np.divide(np.nansum(steps, axis=0), sides, out=gradient, where=sides > 0)
        squared += gradient**2
    return np.arctan(np.sqrt(squared))


def _steps(heights_m: Float64Array, axis: int) -> Float64Array:
    """Return (2, rows, columns): step from the cell before and to the cell after; NaN = none."""
    steps = np.diff(heights_m, axis=axis)
    sides = []
    for side in ((1, 0), (0, 1)):
        padding = [(0, 0), (0, 0)]
        padding[axis] = side
        sides.append(np.pad(steps, padding, constant_values=np.nan))
    return np.stack(sides)


def _checked(
    map_: ElevationMap, truth_m: NDArray[np.floating], visible: BoolArray | None
) -> Float64Array:
    for what, array in (("truth", truth_m), ("visible mask", visible)):
        if array is not None and array.shape != map_.state.shape:
            raise MappingError(
                f"the {what} has shape {array.shape} and the map {map_.state.shape}; "
                "give the heights at the map's cells"
            )
    return np.where(np.isfinite(truth_m), truth_m, np.nan).astype(np.float64)


def _share(found: BoolArray, visible: BoolArray, outside: float) -> float:
    total = np.count_nonzero(visible) + outside
    return float(np.count_nonzero(found) / total) if total else float("nan")


def _overall(scores: Scores) -> Accuracy:
    """Return the numbers of all cells alone."""
    return Accuracy(*(getattr(scores, name) for name in Accuracy.__dataclass_fields__))
