"""The true terrain as a file, and brought to the cells of a map."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from drivers.depth.trajectory import Trajectory
from mapping.cells.elevation_map import CellState, ElevationMap
from mapping.errors import MappingError
from mapping.judging.accuracy import BoolArray, Float64Array
from mapping.judging.evaluation import (
    CONFIRMED,
    EDGE_STEP_PER_CELL,
    Scores,
    counted_cells,
    evaluate,
)
from mapping.judging.rover_view import (
    RelativeCells,
    RoverTracks,
    check_overlap,
    relative_cells,
    seen_from_m,
)
from mapping.output.netcdf import (
    CONVENTIONS,
    FRAME,
    read_netcdf,
    software,
    what_lacks,
    write_netcdf,
)

# Positions nearer to a grid point than this share of a step are that point: rounding of floats.
_SNAP = 1e-6


@dataclass(frozen=True, slots=True)
class Truth:
    """True heights in the terrain frame on a grid of their own.

    Attributes:
        x_m, y_m: grid points, strictly increasing.
        height_m: (len(y_m), len(x_m)), NaN = not known.
        visible: points that the sensor could see in the run; None = not known.
        poses: of the tracked body in the run; None = not known.
    """

    x_m: Float64Array
    y_m: Float64Array
    height_m: Float64Array
    visible: BoolArray | None = None
    poses: Trajectory | None = None

    def __post_init__(self) -> None:
        """Refuse grids that do not fit together."""
        shape = (self.y_m.size, self.x_m.size)
        if self.height_m.shape != shape or min(shape) == 0:
            raise MappingError(f"truth heights have shape {self.height_m.shape}; expected {shape}")
        if self.visible is not None and self.visible.shape != shape:
            raise MappingError(f"visible mask has shape {self.visible.shape}; expected {shape}")
        if not all(np.all(np.diff(axis) > 0.0) for axis in (self.x_m, self.y_m)):
            raise MappingError("truth coordinates must increase strictly; sort the grid")

    def truth_at(self, map_: ElevationMap) -> Truth:
        """Return the truth at a map's cell centres.

        Heights are exact where a grid point is the cell centre, bilinear between points, NaN
        outside and beside NaN. A cell is visible when its nearest grid point is.
        """
        x, y = _places(self.x_m, map_.x_m), _places(self.y_m, map_.y_m)
        left = _between(self.height_m[:, x.lower], self.height_m[:, x.upper], x.weight)
        weight = y.weight[:, np.newaxis]
        height = _between(left[y.lower], left[y.upper], weight)
        height[~y.inside] = np.nan
        height[:, ~x.inside] = np.nan
        visible = None
        if self.visible is not None:
            visible = self.visible[np.ix_(y.nearest, x.nearest)] & np.isfinite(height)
        return Truth(map_.x_m, map_.y_m, height, visible)

    def visible_outside(self, map_: ElevationMap) -> float:
        """Return the visible area beyond a map's rectangle, in cells of that map."""
        if self.visible is None:
            return 0.0
        half = 0.5 * map_.resolution_m
        in_x = (self.x_m > map_.x_m[0] - half) & (self.x_m < map_.x_m[-1] + half)
        in_y = (self.y_m > map_.y_m[0] - half) & (self.y_m < map_.y_m[-1] + half)
        outside = self.visible & np.isfinite(self.height_m) & ~np.outer(in_y, in_x)
        area_m2 = np.outer(_widths_m(self.y_m), _widths_m(self.x_m))
        return float(area_m2[outside].sum() / map_.resolution_m**2)


def evaluate_truth(
    map_: ElevationMap,
    truth: Truth,
    states: tuple[CellState, ...] = CONFIRMED,
    believed: Trajectory | None = None,
) -> Scores:
    """Compare a map with a truth on any grid; see `mapping.judging.evaluation.evaluate`.

    Args:
        map_: the map.
        truth: the truth; with poses, ranges and relative errors are judged too.
        states: states of the cells that count.
        believed: the poses that the map was made with; the true ones when left out.

    Raises:
        MappingError: as `evaluate`, or the truth has no poses to compare `believed` with, or
            those are of another time than the map.
    """
    here = truth.truth_at(map_)
    if believed is not None:
        if truth.poses is None:
            raise MappingError(
                f"the truth holds no poses to compare {believed.path} with; leave the trajectory "
                "out, or give the truth of a simulated run"
            )
        check_overlap(map_, believed)
    tracks = None if truth.poses is None else RoverTracks(truth.poses, believed or truth.poses)
    return evaluate(
        map_,
        here.height_m,
        here.visible,
        visible_outside=truth.visible_outside(map_),
        states=states,
        range_m=None if tracks is None else seen_from_m(map_, tracks.believed),
        relative={} if tracks is None else _relative(map_, truth, tracks, states),
    )


def _relative(
    map_: ElevationMap, truth: Truth, tracks: RoverTracks, states: tuple[CellState, ...]
) -> dict[str, RelativeCells]:
    """Return the cells relative to the rover when each was last seen, and at the end."""
    end_ns = np.full_like(map_.last_seen_ns, map_.last_seen_ns.max())
    moments = {"when_seen": map_.last_seen_ns, "at_end": end_ns}
    heights = RegularGridInterpolator(
        (truth.y_m, truth.x_m), truth.height_m, bounds_error=False, fill_value=np.nan
    )
    cells, step_m = counted_cells(map_, states), EDGE_STEP_PER_CELL * map_.resolution_m
    return {
        name: relative_cells(map_, cells, heights, tracks, t_ns, step_m)
        for name, t_ns in moments.items()
    }


def write_truth(path: Path, truth: Truth) -> None:
    """Write a truth to a NetCDF file that `read_truth` gives back bit for bit.

    Raises:
        MappingError: the file cannot be written.
    """
    axis = {"units": "m", "long_name": "grid point in the terrain frame"}
    dataset = xr.Dataset(
        {
            "height": (
                ("y", "x"),
                truth.height_m,
                {"units": "m", "long_name": "true height of the terrain, z up"},
            )
        },
        coords={"y": ("y", truth.y_m, axis), "x": ("x", truth.x_m, axis)},
        attrs={"Conventions": CONVENTIONS, "source": software(), "frame": FRAME},
    )
    if truth.visible is not None:
        dataset["visible"] = (
            ("y", "x"),
            truth.visible.astype(np.uint8),
            {
                "units": "1",
                "long_name": "whether the sensor could see the point",
                "flag_values": np.array([0, 1], np.uint8),
                "flag_meanings": "hidden visible",
            },
        )
    write_netcdf(dataset, path)


def read_truth(path: Path) -> Truth:
    """Return the truth in a NetCDF file with x, y, height and perhaps visible.

    Raises:
        MappingError: the file cannot be read or does not hold these arrays.
    """
    dataset = read_netcdf(path)
    try:
        x, y = (dataset.variables[name].values.astype(np.float64) for name in ("x", "y"))
        height = dataset["height"].transpose("y", "x").values.astype(np.float64)
        visible = None
        if "visible" in dataset:
            visible = dataset["visible"].transpose("y", "x").values != 0
        return Truth(x, y, height, visible, _poses(path, dataset))
    except (KeyError, ValueError, MappingError) as error:
        raise MappingError(
            f"{path} holds no truth ({what_lacks(error)}); "
            "expected x and y in metres and height (y, x) in metres"
        ) from error


def _poses(path: Path, dataset: xr.Dataset) -> Trajectory | None:
    """Return the poses of the tracked body, where the file has some."""
    if not {"position", "quat_wxyz"} <= dataset.variables.keys():
        return None
    t_ns = dataset["position_time"].values.astype(np.int64)
    position = dataset["position"].values.astype(np.float64)
    quat = dataset["quat_wxyz"].values.astype(np.float64)
    if position.shape != (t_ns.size, 3) or quat.shape != (t_ns.size, 4):
        raise MappingError(f"poses of shape {position.shape} and {quat.shape} at {t_ns.size} times")
    return Trajectory(path, t_ns, position, quat[:, [1, 2, 3, 0]])


@dataclass(frozen=True, slots=True)
class _Places:
    """Where positions lie on an axis: (n,) each; between point `lower` and point `upper`."""

    lower: NDArray[np.intp]
    upper: NDArray[np.intp]
    weight: Float64Array  # of `upper`
    inside: BoolArray

    @property
    def nearest(self) -> NDArray[np.intp]:
        return np.where(self.weight > 0.5, self.upper, self.lower)


def _places(axis_m: Float64Array, positions_m: Float64Array) -> _Places:
    if axis_m.size == 1:
        here = np.zeros(positions_m.size, np.intp)
        return _Places(here, here, np.zeros(here.size), positions_m == axis_m[0])
    upper = np.clip(np.searchsorted(axis_m, positions_m), 1, axis_m.size - 1)
    lower = upper - 1
    weight = (positions_m - axis_m[lower]) / (axis_m[upper] - axis_m[lower])
    weight = np.where(np.abs(weight - np.rint(weight)) < _SNAP, np.rint(weight), weight)
    inside = (weight >= 0.0) & (weight <= 1.0)
    return _Places(lower, upper, np.clip(weight, 0.0, 1.0), inside)


def _between(
    lower: Float64Array, upper: Float64Array, weight: NDArray[np.floating]
) -> Float64Array:
    """Interpolate; a point of weight 0 has no say, not even when it is NaN."""
    mixed = (1.0 - weight) * lower + weight * upper
    return np.where(weight == 0.0, lower, np.where(weight == 1.0, upper, mixed))


def _widths_m(axis_m: Float64Array) -> Float64Array:
    """Return the width of the ground that each grid point stands for."""
    return np.gradient(axis_m) if axis_m.size > 1 else np.zeros(1)
