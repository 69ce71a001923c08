"""Tiles of cells in one zarr array: each is one chunk, which is one file.

The array has one plane for every layer (`mapping.world.planes`) and a side of 2^36 cells; chunks
that were never written take no space. Cell (ix, iy) of the terrain frame is at
[:, iy + 2^35, ix + 2^35]. zarr writes a chunk under a temporary name and renames it, so a kill
leaves the old tile or the new one; each carries a checksum, against disks that lose power.
"""

from __future__ import annotations

import importlib
import os
import shutil
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from acquisition.files import synchronise
from mapping.cells.cell_layers import CellLayers
from mapping.errors import MappingError
from mapping.world.planes import from_planes, plane_names, to_planes
from mapping.world.tiles import TILE_CELLS, Tile

if TYPE_CHECKING:
    import zarr

SIDE_CELLS = 2**36
ORIGIN_CELL = SIDE_CELLS // 2
ARRAY_FILE = "zarr.json"
_TILES = "c"  # zarr's own names: c/plane/row/column


class TileArray:
    """Tiles in a folder.

    Args:
        path: the folder, with an array in it that `make` has made.
        writable: whether tiles will be written.
    """

    def __init__(self, path: Path, *, writable: bool) -> None:
        self.path = path
        self._mode = "r+" if writable else "r"

    @classmethod
    def make(cls, path: Path, attributes: Mapping[str, Any]) -> None:
        """Make an array without tiles.

        Raises:
            MappingError: zarr is missing.
            OSError: it cannot be written.
        """
        library = load_zarr()
        compressor = library.codecs.BloscCodec(cname="zstd", clevel=1, shuffle="shuffle")
        planes = len(plane_names())
        library.create_array(
            library.storage.LocalStore(path),
            shape=(planes, SIDE_CELLS, SIDE_CELLS),
            chunks=(planes, TILE_CELLS, TILE_CELLS),
            dtype="float64",
            fill_value=0.0,
            compressors=[compressor, library.codecs.Crc32cCodec()],
            dimension_names=("plane", "y", "x"),
            attributes=dict(attributes),
        )

    @property
    def attributes(self) -> dict[str, Any]:
        """What `make` was given.

        Raises:
            MappingError: zarr is missing.
            OSError, KeyError, ValueError, TypeError: there is no such array.
        """
        return dict(self._array.attrs)

    def has(self, tile: Tile) -> bool:
        """Tell whether a tile was written."""
        return self._file(tile).exists()

    def tiles(self) -> set[Tile]:
        """Return the tiles that were written.

        Raises:
            OSError: the folder cannot be read.
        """
        middle = ORIGIN_CELL // TILE_CELLS
        found = (file.parts[-2:] for file in self._files())
        return {(int(x) - middle, int(y) - middle) for y, x in found}

    def read(self, tile: Tile) -> CellLayers:
        """Return a tile's layers (128, 128); all 0 where nothing was written.

        Raises:
            MappingError: the tile is damaged, or may not be read.
        """
        try:
            planes = self._array[_place(tile)]
        except OSError as error:
            raise MappingError(
                f"cannot read {self._file(tile)}: {error.strerror}; make it readable"
            ) from error
        except (RuntimeError, ValueError) as error:
            raise MappingError(
                f"{self._file(tile)} is damaged ({error}); take it from a backup, or delete it to "
                "go on without that tile"
            ) from error
        return from_planes(np.asarray(planes))

    def write(self, tile: Tile, layers: CellLayers) -> None:
        """Replace a tile by layers (128, 128), and see its bytes onto the disk.

        A tile without anything in it is a file too: it has to take the place of one that has.

        Raises:
            OSError: it cannot be written; the tile stays as it was.
        """
        self._array[_place(tile)] = to_planes(layers)
        synchronise(self._file(tile), os.O_RDONLY)

    def hand_over(self, other: TileArray) -> None:
        """Move all tiles to another array on the same disk, and see the names onto it.

        Raises:
            OSError: one cannot be moved; the others are in either of the arrays.
        """
        entered = set[Path]()
        for file in list(self._files()):
            target = other.path / file.relative_to(self.path)
            target.parent.mkdir(parents=True, exist_ok=True)
            file.replace(target)
            entered.add(target.parent)
        for folder in sorted(entered):
            synchronise(folder, os.O_RDONLY | os.O_DIRECTORY)
        self.clear()

    def synchronise(self) -> None:
        """See the names of all tiles onto the disk.

        Raises:
            OSError: the disk refuses.
        """
        for folder in sorted({file.parent for file in self._files()}):
            synchronise(folder, os.O_RDONLY | os.O_DIRECTORY)

    def clear(self) -> None:
        """Remove all tiles, and what a killed writer left half done; see that onto the disk.

        Raises:
            OSError: the folder cannot be written.
        """
        if (self.path / _TILES).exists():
            shutil.rmtree(self.path / _TILES)
            synchronise(self.path, os.O_RDONLY | os.O_DIRECTORY)

    @cached_property
    def _array(self) -> zarr.Array[Any]:
        array: zarr.Array[Any] = load_zarr().open_array(self.path, mode=self._mode)
        return array.with_config({"write_empty_chunks": True})

    def _files(self) -> Iterator[Path]:
        if not (self.path / _TILES).exists():
            return
        # Unlike a glob, this does not pass over what may not be read.
        for folder, _, names in os.walk(self.path / _TILES, onerror=_refuse):
            yield from (Path(folder, name) for name in names if name.isdigit())

    def _file(self, tile: Tile) -> Path:
        x, y = (ORIGIN_CELL // TILE_CELLS + number for number in tile)
        return self.path / _TILES / "0" / str(y) / str(x)


def load_zarr() -> ModuleType:
    """Return zarr, which is an extra and takes 0.2 s to import.

    Raises:
        MappingError: it is not installed.
    """
    try:
        return importlib.import_module("zarr")
    except ImportError as error:
        raise MappingError(
            "a world map needs zarr, which is not installed; run pip install 'terravibe[world]'"
        ) from error


def _refuse(error: OSError) -> None:
    raise error


def _place(tile: Tile) -> tuple[slice, slice, slice]:
    x, y = (ORIGIN_CELL + number * TILE_CELLS for number in tile)
    return slice(None), slice(y, y + TILE_CELLS), slice(x, x + TILE_CELLS)
