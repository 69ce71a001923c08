"""The map as one NetCDF-4 file by the CF conventions; any NetCDF program opens it.

Dimensions (y, x), cell centres in metres, row 0 = smallest y. `lower`, `upper` and the layers of
`mapping.ground.layers` and `mapping.ground.fusion` follow from the others: they are written for
readers, and neither read back nor part of the checksum of the map's arrays. `time` is in plain
nanoseconds of the recording's clock: as a date it would be wrong for a monotonic clock, and as a
floating number it would lose its last digits.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from mapping.cells.elevation_map import CellState, ElevationMap
from mapping.errors import MappingError
from mapping.ground.fusion import fuse_map
from mapping.ground.layers import LayerSettings, derive
from mapping.output.netcdf import CONVENTIONS, FRAME, damaged, read_netcdf, software, write_netcdf

_SHA256 = "arrays_sha256"
_RESOLUTION = "cell_size_m"
# Before the names of `ElevationMap.attributes` in the file, so that no name can mean two things.
_PREFIX = "map_"


class _Layer(NamedTuple):
    """A layer of the file: field of `ElevationMap` or `DerivedLayers` that it holds."""

    field: str
    units: str
    long_name: str
    standard_name: str | None = None


_LAYERS = {
    "elevation": _Layer("elevation_m", "m", "height of the terrain in the cell, z up"),
    "variance": _Layer("variance_m2", "m2", "variance of the height: sum of its five parts"),
    "lower": _Layer("lower_m", "m", "height minus 3 standard deviations"),
    "upper": _Layer("upper_m", "m", "height plus 3 standard deviations"),
    "independent_variance": _Layer(
        "independent_m2", "m2", "part of the variance that differs from frame to frame"
    ),
    "systematic_variance": _Layer(
        "systematic_m2", "m2", "part of the variance that is the same all through the run"
    ),
    "relief_variance": _Layer(
        "relief_m2", "m2", "part of the variance from the shape of the surface in the cell"
    ),
    "pose_variance": _Layer(
        "pose_m2", "m2", "part of the variance from height and tilt of the poses"
    ),
    "horizontal_variance": _Layer(
        "horizontal_m2", "m2", "part of the variance from the errors of the cell's place by motion"
    ),
    "horizontal_xx": _Layer("horizontal_xx_m2", "m2", "variance of the cell's place along x"),
    "horizontal_xy": _Layer("horizontal_xy_m2", "m2", "covariance of the cell's place, x and y"),
    "horizontal_yy": _Layer("horizontal_yy_m2", "m2", "variance of the cell's place along y"),
    "count": _Layer("frames", "1", "frames that contributed", "number_of_observations"),
    "pixels": _Layer("pixels", "1", "depth readings in those frames"),
    "time": _Layer("last_seen_ns", "ns", "clock of the last contribution, 0 where there is none"),
    "state": _Layer("state", "1", "what is known of the cell", "status_flag"),
}
_NOT_READ = ("lower", "upper")
_DERIVED_LAYERS = {
    "slope": _Layer("slope_rad", "rad", "angle between the surface and the horizontal"),
    "slope_sigma": _Layer("slope_sigma_rad", "rad", "standard deviation of the slope"),
    "normal_x": _Layer("normal_x", "1", "x of the upward unit normal, whose z is cos(slope)"),
    "normal_y": _Layer("normal_y", "1", "y of the upward unit normal, whose z is cos(slope)"),
    "roughness": _Layer("roughness_m", "m", "standard deviation of the distances from a plane"),
    "roughness_noise": _Layer(
        "roughness_noise_m", "m", "roughness that sensor noise alone would show"
    ),
    "step": _Layer("step_m", "m", "range of the heights around the cell"),
    "traversability": _Layer("traversability", "1", "0 = beyond a limit, 1 = level and smooth"),
}
_FUSED_LAYERS = {
    "fused_elevation": _Layer(
        "elevation_m", "m", "mean height over the errors of the cell's place"
    ),
    "fused_variance": _Layer("variance_m2", "m2", "variance of that mean"),
    "fused_lower": _Layer("lower_m", "m", "lower bound, errors of height and place"),
    "fused_upper": _Layer("upper_m", "m", "upper bound, errors of height and place"),
}


def write_map(map_: ElevationMap, path: Path) -> None:
    """Write a map to a file that `read_map` gives back bit for bit; equal maps, equal bytes.

    Raises:
        MappingError: the file cannot be written; an older one at `path` stays as it was.
    """
    write_netcdf(_dataset(map_), path)


def read_map(path: Path) -> ElevationMap:
    """Return the map in a file.

    Raises:
        MappingError: the file cannot be read, is no map, or is not as it was written.
    """
    dataset = read_netcdf(path)
    stored = {name: layer for name, layer in _LAYERS.items() if name not in _NOT_READ}
    missing = sorted({*stored, "x", "y"} - set(dataset.variables))
    missing += sorted({_SHA256, _RESOLUTION} - set(dataset.attrs))
    if missing:
        raise MappingError(
            f"{path} is no terravibe map: it has no {_some(missing)}; "
            "give a file made by 'terravibe map'"
        )
    map_ = ElevationMap(
        resolution_m=float(dataset.attrs[_RESOLUTION]),
        x_m=dataset["x"].values,
        y_m=dataset["y"].values,
        attributes=_attributes(dataset),
        **{layer.field: dataset[name].values for name, layer in stored.items()},
    )
    if map_.sha256() != dataset.attrs[_SHA256]:
        raise damaged(path)
    return map_


def _dataset(map_: ElevationMap) -> xr.Dataset:
    layer_settings = LayerSettings()
    sources = (
        (map_, _LAYERS),
        (derive(map_, layer_settings), _DERIVED_LAYERS),
        (fuse_map(map_), _FUSED_LAYERS),
    )
    dataset = xr.Dataset(
        {
            name: (("y", "x"), getattr(source, layer.field), _layer_attributes(name, layer))
            for source, layers in sources
            for name, layer in layers.items()
        },
        coords={axis: _axis(axis, getattr(map_, f"{axis}_m")) for axis in ("x", "y")},
        attrs={
            "Conventions": CONVENTIONS,
            "title": "Elevation map with the variance of every height",
            "source": software(),
            "frame": FRAME,
            _RESOLUTION: map_.resolution_m,
            _SHA256: map_.sha256(),
        },
    )
    dataset.attrs |= {f"layer_{name}": value for name, value in asdict(layer_settings).items()}
    dataset.attrs |= {f"{_PREFIX}{name}": value for name, value in map_.attributes.items()}
    return dataset


def _layer_attributes(name: str, layer: _Layer) -> dict[str, object]:
    attributes: dict[str, object] = {"long_name": layer.long_name, "units": layer.units}
    if layer.standard_name:
        attributes["standard_name"] = layer.standard_name
    if name == "elevation":
        attributes["cell_methods"] = "area: mean"
        attributes["ancillary_variables"] = " ".join(other for other in _LAYERS if other != name)
    if name == "state":
        attributes["flag_values"] = np.array([state.value for state in CellState], np.uint8)
        attributes["flag_meanings"] = " ".join(state.name.lower() for state in CellState)
    return attributes


def _axis(axis: str, centres_m: np.ndarray) -> tuple[str, np.ndarray, dict[str, str]]:
    return (
        axis,
        centres_m,
        {
            "long_name": f"{axis} of the cell's centre in the terrain frame",
            "standard_name": f"projection_{axis}_coordinate",
            "units": "m",
            "axis": axis.upper(),
        },
    )


def _some(names: list[str]) -> str:
    """Return the first three of many names."""
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(names[:3]) + more


def _attributes(dataset: xr.Dataset) -> dict[str, str | int | float]:
    """Return the map's own attributes as plain Python values."""
    return {
        name.removeprefix(_PREFIX): value.item() if isinstance(value, np.generic) else value
        for name, value in dataset.attrs.items()
        if name.startswith(_PREFIX)
    }
