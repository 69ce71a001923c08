"""Tiles of cells in a zarr array: each is one chunk, replaced as a whole or not at all.

The array has one plane for every layer (`mapping.world.planes`) and a side of 2^36 cells; chunks
that were never written take no space. Cell (ix, iy) of the terrain frame is at
[:, iy + 2^35, ix + 2^35]. zarr writes a chunk under a temporary name and renames it, so a kill
leaves the old tile or the new one; each carries a checksum, against disks that lose power.
"""

from __future__ import annotations

import fcntl
import importlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType, TracebackType
from typing import IO, TYPE_CHECKING, Any, Self

import numpy as np

from mapping.cells.cell_layers import CellLayers
from mapping.errors import MappingError
from mapping.world.planes import from_planes, plane_names, to_planes
from mapping.world.tiles import TILE_CELLS, Tile

if TYPE_CHECKING:
    import zarr

_SIDE_CELLS = 2**36
_ORIGIN = _SIDE_CELLS // 2
_FORMAT = 1
_LOCK = "writer.lock"
_ABOUT = "terravibe_world"


class TileStore:
    """A world map's folder; one writer at a time, any number of readers beside it."""

    def __init__(self, path: Path, array: zarr.Array[Any], lock: IO[bytes] | None) -> None:
        """Use `create`, `reopen` or `read_only` instead."""
        self.path = path
        self._array = array
        self._lock = lock

    @classmethod
    def create(cls, path: Path, about: Mapping[str, object]) -> Self:
        """Make a new world and be its writer.

        Args:
            path: a folder that is not there yet, or is empty.
            about: JSON values that say how the map is made; see `mapping.world.world_map`.

        Raises:
            MappingError: zarr is missing, there is something at `path`, or it cannot be written.
        """
        library = _zarr()
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise MappingError(
                f"cannot make the folder {path}: {error.strerror}; give one that can be written"
            ) from error
        lock = _locked(path)
        try:
            _check_empty(path)
            compressor = library.codecs.BloscCodec(cname="zstd", clevel=1, shuffle="shuffle")
            planes = plane_names()
            array = library.create_array(
                library.storage.LocalStore(path),
                shape=(len(planes), _SIDE_CELLS, _SIDE_CELLS),
                chunks=(len(planes), TILE_CELLS, TILE_CELLS),
                dtype="float64",
                fill_value=0.0,
                compressors=[compressor, library.codecs.Crc32cCodec()],
                dimension_names=("plane", "y", "x"),
                attributes={
                    _ABOUT: {
                        "format": _FORMAT,
                        "planes": planes,
                        "origin_cell": _ORIGIN,
                        **json.loads(json.dumps(about)),
                    }
                },
            )
        except BaseException:
            lock.close()
            raise
        return cls(path, array, lock)

    @classmethod
    def reopen(cls, path: Path) -> Self:
        """Be the writer of a world that is there; what a killed writer left half done is removed.

        Raises:
            MappingError: zarr is missing, there is no world at `path`, or another writes to it.
        """
        array = _open(path, "r+")
        lock = _locked(path)
        for left in path.rglob("*.partial"):
            left.unlink()
        return cls(path, array, lock)

    @classmethod
    def read_only(cls, path: Path) -> Self:
        """Read a world, also while another writes to it.

        Raises:
            MappingError: zarr is missing, or there is no world at `path`.
        """
        return cls(path, _open(path, "r"), None)

    @property
    def about(self) -> dict[str, Any]:
        """What `create` was given."""
        return dict(self._array.attrs[_ABOUT])  # type: ignore[arg-type] # JSON: checked in _open

    def read(self, tile: Tile) -> CellLayers:
        """Return a tile's layers (128, 128); all 0 where nothing was written.

        Raises:
            MappingError: the tile is damaged.
        """
        try:
            planes = self._array[self._place(tile)]
        except (RuntimeError, ValueError, OSError) as error:
            raise MappingError(
                f"{self._file(tile)} is damaged ({error}); take it from a backup, or delete it to "
                "go on without that tile"
            ) from error
        return from_planes(np.asarray(planes))

    def write(self, tile: Tile, layers: CellLayers) -> None:
        """Replace a tile by layers (128, 128), and see it onto the disk.

        Raises:
            MappingError: it cannot be written; the tile stays as it was.
        """
        try:
            self._array[self._place(tile)] = to_planes(layers)
            file = self._file(tile)
            if file.exists():  # zarr removes a chunk that is all fill value
                descriptor = os.open(file, os.O_RDONLY)
                try:
                    os.fsync(descriptor)
                finally:
                    os.close(descriptor)
        except OSError as error:
            raise MappingError(
                f"cannot write to the world {self.path}: {error.strerror}; free some space or "
                "give a writable folder, then go on with --continue"
            ) from error

    def tiles(self) -> list[Tile]:
        """Return the tiles that were written, in order."""
        found = (file.relative_to(self.path).parts for file in self.path.glob("c/0/*/*"))
        middle = _ORIGIN // TILE_CELLS
        numbers = [(int(x) - middle, int(y) - middle) for *_, y, x in found if x.isdigit()]
        return sorted(numbers)

    def close(self) -> None:
        """Let another write; does nothing the second time."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _place(self, tile: Tile) -> tuple[slice, slice, slice]:
        x, y = (_ORIGIN + number * TILE_CELLS for number in tile)
        return slice(None), slice(y, y + TILE_CELLS), slice(x, x + TILE_CELLS)

    def _file(self, tile: Tile) -> Path:
        x, y = (_ORIGIN // TILE_CELLS + number for number in tile)
        return self.path / "c" / "0" / str(y) / str(x)


def _zarr() -> ModuleType:
    """Return zarr, which is an extra and takes 0.2 s to import."""
    try:
        return importlib.import_module("zarr")
    except ImportError as error:
        raise MappingError(
            "a world map needs zarr, which is not installed; run pip install 'terravibe[world]'"
        ) from error


def _open(path: Path, mode: str) -> zarr.Array[Any]:
    library = _zarr()
    try:
        array: zarr.Array[Any] = library.open_array(path, mode=mode)
        about: Any = array.attrs[_ABOUT]
        found = about["format"], about["planes"]
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise MappingError(
            f"{path} is no world map; give a folder made by 'terravibe map --world'"
        ) from error
    planes = list(plane_names())
    if found != (_FORMAT, planes):
        raise MappingError(
            f"{path} was made by another version of terravibe: it has format and planes {found}; "
            f"expected {_FORMAT} and {planes}"
        )
    return array


def _check_empty(path: Path) -> None:
    if any(item.name != _LOCK for item in path.iterdir()):
        raise MappingError(
            f"{path} is not empty; give --continue to add to the world in it, or a new name"
        )


def _locked(path: Path) -> IO[bytes]:
    """Return the writer's lock; the system lets go of it however the process ends."""
    try:
        lock = (path / _LOCK).open("wb")
    except OSError as error:
        raise MappingError(
            f"cannot write to the world {path}: {error.strerror}; give a writable folder"
        ) from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        lock.close()
        raise MappingError(
            f"another process is writing to the world {path}; wait for it, or give a new name"
        ) from error
    return lock
