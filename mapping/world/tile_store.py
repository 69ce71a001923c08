"""A world's folder: tiles, and the run that they are from, saved together or not at all.

A save first writes its tiles into one of two arrays beside the world's own, in turns; then
`run.json`, which makes them count (`mapping.world.run_file`); then it moves them home. A kill
before the second step leaves the save before it whole; one after it leaves tiles on the way, which
readers find there and the next writer brings home. What is there is always as after one frame.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

from acquisition.errors import StreamError
from acquisition.files import check_target
from mapping.cells.cell_layers import CellLayers
from mapping.errors import MappingError
from mapping.motion.known_frames import no_keys
from mapping.motion.run_state import RunState, fresh_run
from mapping.world.failures import no_world, reason, unreadable, unwritable
from mapping.world.planes import plane_names
from mapping.world.run_file import (
    FRAMES_FILE,
    MOTIONS_FILE,
    RUN_FILE,
    RunFile,
    SavedRun,
    unfinished,
)
from mapping.world.tile_array import ARRAY_FILE, ORIGIN_CELL, TileArray, load_zarr
from mapping.world.tiles import Tile
from mapping.world.writer_lock import LOCK_FILE, locked

_FORMAT = 2
_STAGED = ("staged.0", "staged.1")
_RUN_FILES = (RUN_FILE, MOTIONS_FILE, FRAMES_FILE)
_ABOUT = "terravibe_world"


class TileStore:
    """A world map's folder; one writer at a time, any number of readers beside it."""

    def __init__(self, path: Path, lock: IO[bytes] | None) -> None:
        """Use `create`, `reopen` or `read_only` instead."""
        self.path = path
        self._lock = lock
        self._is_new = self._made_folder = False
        self._home = _home(path, writable=lock is not None)
        self._staged = [TileArray(path / name, writable=lock is not None) for name in _STAGED]
        self._run_file = RunFile(path)
        self._saved = self._run_file.read()

    @classmethod
    def create(cls, path: Path, about: Mapping[str, object]) -> Self:
        """Make a new world and be its writer.

        Args:
            path: a folder that is not there yet, or is empty.
            about: JSON values that say how the map is made; see `mapping.world.world_map`.

        Raises:
            MappingError: zarr is missing, there is something at `path`, or it cannot be written.
        """
        load_zarr()
        if path.exists() and not path.is_dir():
            raise MappingError(f"{path} is a file; a world is a folder: give another name")
        is_missing = not path.exists()
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise MappingError(
                f"cannot make the folder {path}: {error.strerror}; give one that can be written"
            ) from error
        lock = locked(path)
        try:
            _check_empty(path)
        except MappingError:
            lock.close()
            raise
        try:
            _furnish(path, about)
            store = cls(path, lock)
        except BaseException:
            _remove(path, folder_too=is_missing)
            lock.close()
            raise
        store._is_new, store._made_folder = True, is_missing
        return store

    @classmethod
    def reopen(cls, path: Path) -> Self:
        """Be the writer of a world that is there; what a killed writer left is put in order.

        Raises:
            MappingError: zarr is missing, there is no world at `path`, it is damaged or of another
                version, it cannot be written, or another writes to it.
        """
        _home(path, writable=False)
        lock = locked(path)
        try:
            check_target(path / RUN_FILE)
            store = cls(path, lock)
            store._put_in_order()
        except BaseException as error:
            lock.close()
            if isinstance(error, OSError | StreamError):
                raise unwritable(path, error) from error
            raise
        return store

    @classmethod
    def read_only(cls, path: Path) -> Self:
        """Read a world, also while another writes to it.

        Raises:
            MappingError: zarr is missing, there is no world at `path`, or it is damaged or of
                another version.
        """
        return cls(path, None)

    @property
    def about(self) -> dict[str, Any]:
        """What `create` was given."""
        return dict(self._home.attributes[_ABOUT])

    @property
    def run(self) -> RunState:
        """The run that the cells are from, as of the last save."""
        return self._saved.run

    def is_current(self) -> bool:
        """Tell whether there was no save since this was opened, but for its own.

        Raises:
            MappingError: the world is damaged.
        """
        return RunFile(self.path).read().save == self._saved.save

    def read(self, tile: Tile) -> CellLayers:
        """Return a tile's layers (128, 128) as of the last save; 0 where nothing was written.

        Raises:
            MappingError: the tile is damaged.
        """
        staged = self._staged[self._saved.save % 2]
        if staged.has(tile):
            layers = staged.read(tile)
            if staged.has(tile):  # else it went home while it was read
                return layers
        return self._home.read(tile)

    def save(self, tiles: Mapping[Tile, CellLayers], run: RunState) -> None:
        """Replace tiles by layers (128, 128) and the run by what it has become, all or nothing.

        Raises:
            MappingError: it cannot be written; the world stays as it was.
        """
        saved = SavedRun(self._saved.save + 1, run)
        staged = self._staged[saved.save % 2]
        try:
            try:
                for tile, layers in tiles.items():
                    staged.write(tile, layers)
                staged.synchronise()
                self._run_file.write(saved)
            except (OSError, StreamError):
                staged.clear()
                raise
            self._saved = saved
            staged.hand_over(self._home)
        except (OSError, StreamError) as error:
            raise unwritable(self.path, error) from error

    def tiles(self) -> list[Tile]:
        """Return the tiles that were written, in order.

        Raises:
            MappingError: the folder cannot be read.
        """
        try:
            return sorted(self._home.tiles() | self._staged[self._saved.save % 2].tiles())
        except OSError as error:
            raise unreadable(self.path) from error

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
        """Close; a new world into which an error let nothing come is removed."""
        if error is not None and self._is_new and self._saved.save == 0:
            _remove(self.path, folder_too=self._made_folder)
        self.close()

    def _put_in_order(self) -> None:
        """Finish or undo the save that a killed writer was at."""
        for left in [*self.path.rglob("*.partial"), *unfinished(self.path)]:
            left.unlink()
        self._staged[(self._saved.save + 1) % 2].clear()
        self._staged[self._saved.save % 2].hand_over(self._home)


def _home(path: Path, *, writable: bool) -> TileArray:
    """Return a world's own array.

    Raises:
        MappingError: it has none, or one of another version.
    """
    array = TileArray(path, writable=writable)
    try:
        about: Any = array.attributes[_ABOUT]
        found = about["format"], about["planes"]
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise no_world(path) from error
    planes = list(plane_names())
    if found[0] == 1:
        raise MappingError(
            f"the world {path} has format 1, which lacks the rover's motions; expected format "
            f"{_FORMAT}: map its recordings into a new world"
        )
    if found != (_FORMAT, planes):
        raise MappingError(
            f"{path} was made by another version of terravibe: it has format and planes {found}; "
            f"expected {_FORMAT} and {planes}"
        )
    return array


def _furnish(path: Path, about: Mapping[str, object]) -> None:
    """Put an empty world into a folder; it is one when the last file is there.

    What a process that was killed here has left is replaced.

    Raises:
        MappingError: it cannot be written.
    """
    attributes = {
        "format": _FORMAT,
        "planes": plane_names(),
        "origin_cell": ORIGIN_CELL,
        **json.loads(json.dumps(about)),
    }
    try:
        for name in _STAGED:
            shutil.rmtree(path / name, ignore_errors=True)
            TileArray.make(path / name, {})
        RunFile(path).write(SavedRun(0, replace(fresh_run(), frames=no_keys())))
        TileArray.make(path, {_ABOUT: attributes})
    except (OSError, StreamError) as error:
        raise MappingError(
            f"cannot make a world in {path}: {reason(error)}; free some space or give a writable "
            "folder"
        ) from error


def _check_empty(path: Path) -> None:
    """Refuse a folder with anything in it, but for what is left of a world that was never begun."""
    names = {item.name for item in path.iterdir() if item not in unfinished(path)} - {LOCK_FILE}
    if ARRAY_FILE in names or not names <= {*_STAGED, *_RUN_FILES}:
        raise MappingError(
            f"{path} is not empty; give --continue to add to the world in it, or a new name"
        )


def _remove(path: Path, *, folder_too: bool) -> None:
    """Remove a world in which nothing was saved, as far as the system lets us."""
    with suppress(OSError):
        (path / ARRAY_FILE).unlink(missing_ok=True)
        for name in _STAGED:
            shutil.rmtree(path / name, ignore_errors=True)
        for file in [*(path / name for name in (*_RUN_FILES, LOCK_FILE)), *unfinished(path)]:
            file.unlink(missing_ok=True)
        if folder_too and not any(path.iterdir()):
            path.rmdir()
