"""The command that hands maps on to other programs, and the drawing of figures.

Nothing heavy is imported before a command runs.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from acquisition.commands.console import OK, Console

if TYPE_CHECKING:
    from mapping.cells.elevation_map import ElevationMap


def draw(map_: ElevationMap, folder: Path, console: Console) -> None:
    """Draw all figures of a map into a folder."""
    from mapping.output.figures import write_figures

    with console.progress(f"drawing into {folder}"):
        write_figures(map_, folder)


def add_export_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe export`."""
    parser.add_argument("map", type=Path, help="FILE.nc, or a world map's DIR.zarr")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help=".tif, .ply, .png, .nc")
    parser.add_argument(
        "--window",
        dest="window_m",
        nargs=4,
        type=float,
        metavar=("X0", "Y0", "X1", "Y1"),
        help="this rectangle of a world, in metres (all of it)",
    )
    parser.add_argument("--figures", type=Path, metavar="DIR", help="draw all figures into DIR")
    parser.add_argument("--json", action="store_true", help="print what was written as JSON")


def run_export(options: argparse.Namespace, console: Console) -> int:
    """Convert a map to what other programs read."""
    from acquisition.files import refuse_same_file
    from mapping.errors import MappingError
    from mapping.output.export import export
    from mapping.output.map_file import write_map

    if options.output is None and options.figures is None:
        raise MappingError(
            "nothing to do; give -o FILE (.tif, .ply, .png, .nc), --figures DIR, or both"
        )
    if options.output:
        refuse_same_file(options.map, options.output)
    map_ = _map_or_world(options)
    if options.output:
        write = write_map if options.output.suffix == ".nc" else export
        write(map_, options.output)
    if options.figures:
        draw(map_, options.figures, console)
    written = {"output": options.output, "figures": options.figures}
    if options.json:
        cells = int(map_.known.sum())
        console.json(
            {name: str(path) if path else None for name, path in written.items()}
            | {"shape": list(map_.state.shape), "known_cells": cells, "sha256": map_.sha256()}
        )
    else:
        console.lines(str(path) for path in written.values() if path)
    return OK


def _map_or_world(options: argparse.Namespace) -> ElevationMap:
    """Return a map's file, or a rectangle of a world."""
    from mapping.errors import MappingError
    from mapping.output.map_file import read_map
    from mapping.world.world_map import is_world, read_world

    if is_world(options.map):
        return read_world(options.map, options.window_m)
    if options.window_m is not None and options.map.exists():
        raise MappingError("--window is for world maps; a map file is exported as it is")
    return read_map(options.map)
