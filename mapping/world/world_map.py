"""A rectangle of a world as an ordinary map."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from mapping.cells.cell_layers import CellLayers, copy_cells, empty_layers
from mapping.cells.elevation_map import ElevationMap, read_out
from mapping.cells.grid import CellWindow, megabytes
from mapping.errors import MappingError
from mapping.noise import DepthNoiseModel
from mapping.settings import MapSettings
from mapping.stored_settings import flat, overlaid
from mapping.world.failures import no_world
from mapping.world.tile_store import TileStore
from mapping.world.tiles import TILE_CELLS, shares

# A save in the middle makes the reading begin again.
_TRIES = 5


@dataclass(frozen=True, slots=True)
class _Block:
    """Cells in memory, for `read_out`."""

    extent: CellWindow
    layers: CellLayers

    def unrolled(self) -> CellLayers:
        """Return the layers."""
        return self.layers


def about_world(settings: MapSettings, noise: DepthNoiseModel) -> dict[str, object]:
    """Return what a new world says of how it is made."""
    return {"settings": asdict(settings), "noise": asdict(noise)}


def check_continues(store: TileStore, settings: MapSettings) -> None:
    """Refuse to go on with cells of another size, or with poses of another kind.

    Poses of another source have errors of another kind, and mostly another terrain frame.

    Raises:
        MappingError: the world's cells or poses are others, or it does not know its frames.
    """
    known = settings_of(store)
    if known.resolution_m != settings.resolution_m:
        raise MappingError(
            f"the world {store.path} has cells of {known.resolution_m} m, the settings ask for "
            f"{settings.resolution_m} m; give --resolution {known.resolution_m}, or a new world"
        )
    if known.pose_source != settings.pose_source:
        raise MappingError(
            f"the world {store.path} was made with poses of {known.pose_source}, the settings ask "
            f"for {settings.pose_source}; give --pose-source {known.pose_source}, or a new world"
        )
    if store.run.frames is None:
        raise MappingError(
            f"the world {store.path} does not say which depth frames it holds: it was made before "
            "that was noted; map its recordings into a new world"
        )


def is_world(path: Path) -> bool:
    """Tell whether a name is meant for a world: of a folder, or of one that is not there."""
    return path.is_dir() or (path.suffix == ".zarr" and not path.exists())


def read_world(path: Path, window_m: Sequence[float] | None = None) -> ElevationMap:
    """Return a rectangle of a world as of its last save, also while the world is being written.

    Args:
        path: the world's folder.
        window_m: x_min, y_min, x_max, y_max in the terrain frame; None = all that was seen.

    Raises:
        MappingError: no world, a damaged tile, nothing seen in the window, or too much for the
            memory limit that the world was made with.
    """
    if not (path / "zarr.json").is_file():  # before zarr is asked for, which may not be there
        raise no_world(path)
    for _ in range(_TRIES):
        with TileStore.read_only(path) as store:
            map_ = _read(store, window_m)
            if store.is_current():
                return map_
    raise MappingError(
        f"the world {path} was saved {_TRIES} times while it was read; give a smaller --window, or "
        "wait until the writer has ended"
    )


def _read(store: TileStore, window_m: Sequence[float] | None) -> ElevationMap:
    settings = settings_of(store)
    extent = _all_of(store) if window_m is None else _cells_of(window_m, settings.resolution_m)
    need_mb = megabytes(extent.cells_x, extent.cells_y)
    if need_mb > settings.memory_limit_mb:
        raise MappingError(
            f"the window needs {need_mb:.0f} MB, the limit is {settings.memory_limit_mb:.0f} "
            "MB; give a smaller --window"
        )
    layers = empty_layers(extent.cells_y, extent.cells_x)
    for tile, inside, outside in shares(extent):
        copy_cells(store.read(tile), inside, layers, outside)
    if not layers.frames.any():
        raise MappingError(_nothing_seen(store, settings.resolution_m))
    return read_out(_Block(extent, layers), settings, _attributes(store.about), store.run.rover)


def _nothing_seen(store: TileStore, cell_size_m: float) -> str:
    """Say that a window is beside all that was seen, and where that is."""
    whole = _all_of(store)
    x_m, y_m = whole.first_x * cell_size_m, whole.first_y * cell_size_m
    return (
        f"the world {store.path} has seen nothing in the window; its tiles reach from "
        f"{x_m:g} {y_m:g} to {x_m + whole.cells_x * cell_size_m:g} "
        f"{y_m + whole.cells_y * cell_size_m:g} m: give a --window there, or none"
    )


def settings_of(store: TileStore) -> MapSettings:
    """Return the settings that a world was made with.

    Raises:
        MappingError: it does not say them, or in another form.
    """
    stored = store.about.get("settings")
    return overlaid(MapSettings(), stored, frozenset(), f"what the world {store.path} is made with")


def _all_of(store: TileStore) -> CellWindow:
    tiles = store.tiles()
    if not tiles:
        raise MappingError(f"the world {store.path} is empty; map something into it first")
    first_x, last_x = min(x for x, _ in tiles), max(x for x, _ in tiles)
    first_y, last_y = min(y for _, y in tiles), max(y for _, y in tiles)
    return CellWindow(
        first_x * TILE_CELLS,
        first_y * TILE_CELLS,
        (last_x - first_x + 1) * TILE_CELLS,
        (last_y - first_y + 1) * TILE_CELLS,
    )


def _cells_of(window_m: Sequence[float], cell_size_m: float) -> CellWindow:
    """Return the cells that a rectangle in metres touches."""
    x_min, y_min, x_max, y_max = window_m
    if not (x_min < x_max and y_min < y_max and all(map(math.isfinite, window_m))):
        raise MappingError(
            f"the window is {x_min:g} {y_min:g} {x_max:g} {y_max:g}; expected x_min y_min x_max "
            "y_max in metres, each minimum below its maximum"
        )
    first_x, first_y = math.floor(x_min / cell_size_m), math.floor(y_min / cell_size_m)
    end_x, end_y = math.ceil(x_max / cell_size_m), math.ceil(y_max / cell_size_m)
    return CellWindow(first_x, first_y, end_x - first_x, end_y - first_y)


def _attributes(about: Mapping[str, Any]) -> dict[str, str | int | float]:
    return dict([*flat("setting", about["settings"]), *flat("noise", about["noise"])])
