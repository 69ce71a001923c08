"""A map against the true terrain: errors, coverage of its sigma, completeness."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from types import MappingProxyType

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
from mapping.judging.rover_view import RelativeCells

CONFIRMED = (CellState.MEASURED, CellState.UNCERTAIN)
# A step between neighbours that is higher than this share of a cell's edge (50 degrees) is an
# edge: the cell holds two surfaces, and no single height is its true one.
EDGE_STEP_PER_CELL = 1.2
# Upper ends of the classes of slope, in degrees; the last class has none.
SLOPE_CLASSES_DEG = (5.0, 10.0, 20.0, 30.0)
# Upper ends of the classes of range, in metres; the last class has none.
RANGE_CLASSES_M = (1.0, 1.5, 2.0, 3.0)


@dataclass(frozen=True, slots=True)
class Parts(Accuracy):
    """The numbers of a set of cells away from edges, of parts of it, and of its edges.

    Attributes:
        by_slope: the same numbers by slope of the truth.
        by_range: by distance from where the rover was; empty where nobody knows.
        edges: cells whose truth steps to a neighbour.
    """

    by_slope: Mapping[str, Accuracy]
    by_range: Mapping[str, Accuracy]
    edges: Accuracy

    def overall(self) -> Accuracy:
        """Return the numbers of the set alone."""
        return Accuracy(*(getattr(self, name) for name in Accuracy.__dataclass_fields__))

    def as_json(self) -> Json:
        """Return all numbers by name; those that are not finite as None."""
        return {
            **Accuracy.as_json(self.overall()),
            "by_slope": _parts_as_json(self.by_slope),
            "by_range": _parts_as_json(self.by_range),
            "edges": self.edges.as_json(),
        }


@dataclass(frozen=True, slots=True)
class Scores(Parts):
    """The numbers of all counted cells, in the world and as the rover sees them.

    Attributes:
        completeness: share of the visible cells of the truth that are counted or an edge.
        by_sigma: the same numbers by claimed sigma.
        unconfirmed: cells seen too seldom to be counted; they may hold flying pixels.
        relative: relative to the rover's true pose (`mapping.judging.rover_view`): "when_seen",
            at the moment when each cell was last seen, and "at_end", when the last one was; empty
            where the truth holds no poses.
    """

    completeness: float
    by_sigma: Mapping[str, Accuracy]
    unconfirmed: Accuracy
    relative: Mapping[str, Parts]

    def as_json(self) -> Json:
        """Return all numbers by name; those that are not finite as None."""
        return {
            **Parts.as_json(self),
            "completeness": finite_or_none(self.completeness),
            "by_sigma": _parts_as_json(self.by_sigma),
            "unconfirmed": self.unconfirmed.as_json(),
            "relative": _parts_as_json(self.relative),
        }

    def rows(self) -> dict[str, Accuracy]:
        """Return every set of cells under the name it has in a table."""
        return {
            "all": self.overall(),
            **{f"slope {name}": part for name, part in self.by_slope.items()},
            **{f"range {name}": part for name, part in self.by_range.items()},
            **{f"sigma {name}": part for name, part in self.by_sigma.items()},
            "edges": self.edges,
            "unconfirmed": self.unconfirmed,
            **self.relative_rows(),
        }

    def relative_rows(self) -> dict[str, Accuracy]:
        """Return the sets of cells relative to the rover under the names they have in a table."""
        return {
            f"rover {name.replace('_', ' ')}": part.overall()
            for name, part in self.relative.items()
        }

    def describe(self) -> list[str]:
        """Return the scores as lines of text."""
        return [*table(self.rows()), f"completeness {100.0 * self.completeness:.1f} %"]


def evaluate(
    map_: ElevationMap,
    truth_m: NDArray[np.floating],
    visible: BoolArray | None = None,
    *,
    visible_outside: float = 0.0,
    states: tuple[CellState, ...] = CONFIRMED,
    range_m: Float64Array | None = None,
    relative: Mapping[str, RelativeCells] = MappingProxyType({}),
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
        range_m: distances from where the rover was, shape of the map's layers, NaN = not known.
        relative: cells relative to the rover, under the names that they get in the scores.
        edge_step_m: a cell whose truth differs by more from one of its four neighbours is an
            edge; 1.2 cell edges when left out.

    Raises:
        MappingError: shapes differ, or no counted cell has a truth.
    """
    truth = _checked(map_, truth_m, visible)
    has_truth = np.isfinite(truth)
    counted = counted_cells(map_, states) & has_truth
    step_m = EDGE_STEP_PER_CELL * map_.resolution_m if edge_step_m is None else edge_step_m
    edge = edge_cells(truth, step_m)
    smooth = counted & ~edge
    _require_some(smooth)
    error, sigma = map_.elevation_m - truth, map_.sigma_m.astype(np.float64)
    slope = slope_rad(truth, map_.resolution_m)
    ranges = None if range_m is None else range_m[counted]
    here = _parts(error[counted], sigma[counted], slope[counted], ranges, edge[counted])
    unconfirmed = (map_.state == CellState.UNCONFIRMED) & has_truth
    visible_cells = has_truth if visible is None else visible & has_truth
    return Scores(
        **{name: getattr(here, name) for name in Parts.__dataclass_fields__},
        completeness=_share(counted & visible_cells, visible_cells, visible_outside),
        by_sigma=_accuracies(error[smooth], sigma[smooth], sigma_classes(sigma[smooth])),
        unconfirmed=accuracy(error[unconfirmed], sigma[unconfirmed]),
        relative={name: _parts(*cells) for name, cells in relative.items()},
    )


def counted_cells(map_: ElevationMap, states: tuple[CellState, ...] = CONFIRMED) -> BoolArray:
    """Return the cells with a height and one of these states."""
    counted: BoolArray = np.isin(map_.state, states) & map_.known
    return counted


def _parts_as_json(parts: Mapping[str, Accuracy]) -> Json:
    """Return parts by name, as JSON values."""
    return {name: part.as_json() for name, part in parts.items()}


def _parts(
    error_m: Float64Array,
    sigma_m: Float64Array,
    slopes_rad: Float64Array,
    range_m: Float64Array | None,
    edge: BoolArray,
) -> Parts:
    """Return the numbers of cells, (N,) arrays; no range, no parts by range."""
    smooth = ~edge
    errors, sigmas = error_m[smooth], sigma_m[smooth]
    by_slope = classes(np.degrees(slopes_rad[smooth]), SLOPE_CLASSES_DEG, "deg")
    by_range = {} if range_m is None else classes(range_m[smooth], RANGE_CLASSES_M, "m")
    return Parts(
        **asdict(accuracy(errors, sigmas)),
        by_slope=_accuracies(errors, sigmas, by_slope),
        by_range=_accuracies(errors, sigmas, by_range),
        edges=accuracy(error_m[edge], sigma_m[edge]),
    )


def _accuracies(
    error_m: Float64Array, sigma_m: Float64Array, parts: Mapping[str, BoolArray]
) -> dict[str, Accuracy]:
    """Return the numbers of each part, given as its mask over the (N,) errors."""
    return {name: accuracy(error_m[cells], sigma_m[cells]) for name, cells in parts.items()}


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
    """Return the truth as float64, NaN for all that is not finite.

    Raises:
        MappingError: truth or mask have another shape than the map.
    """
    for what, array in (("truth", truth_m), ("visible mask", visible)):
        if array is not None and array.shape != map_.state.shape:
            raise MappingError(
                f"the {what} has shape {array.shape} and the map {map_.state.shape}; "
                "give the heights at the map's cells"
            )
    return np.where(np.isfinite(truth_m), truth_m, np.nan).astype(np.float64)


def _require_some(smooth: BoolArray) -> None:
    """Refuse a map without a cell to judge.

    Raises:
        MappingError: no cell is confirmed, has a truth and is no edge.
    """
    if not smooth.any():
        raise MappingError(
            "no confirmed cell of the map has a true height beside it; check that map and truth "
            "are in the same frame and overlap"
        )


def _share(found: BoolArray, visible: BoolArray, outside: float) -> float:
    """Return found cells over visible ones, `outside` more of which lie beyond the map."""
    total = np.count_nonzero(visible) + outside
    return float(np.count_nonzero(found) / total) if total else float("nan")
