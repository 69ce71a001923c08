"""Whole files: a product appears under its name when it is complete, or not at all."""

from __future__ import annotations

from pathlib import Path

from acquisition.errors import StreamError
from acquisition.files import replacing
from mapping.errors import MappingError


def write_whole(path: Path, content: bytes) -> None:
    """Write a file under a temporary name beside `path`, then give it its name.

    Whatever goes wrong, an older file at `path` stays as it was and no temporary file is left.

    Raises:
        MappingError: the folder is missing or not writable, `path` is a folder, the disk is full.
    """
    try:
        with replacing(path) as temporary:
            temporary.write_bytes(content)
    except StreamError as error:
        raise MappingError(str(error)) from error
    except OSError as error:
        raise MappingError(
            f"cannot write {path}: {error.strerror}; give a file in a writable folder with "
            f"{len(content)} bytes to spare"
        ) from error


def make_folder(folder: Path) -> None:
    """Make a folder for products, and those that it lies in, where they are missing.

    Raises:
        MappingError: it cannot be made, or a file has that name.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise MappingError(f"{folder} is a file; give the name of a folder") from error
    except OSError as error:
        raise MappingError(
            f"cannot make the folder {folder}: {error.strerror}; give one that can be written"
        ) from error


def read_whole(path: Path) -> bytes:
    """Return the content of a file.

    Raises:
        MappingError: it cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise MappingError(
            f"cannot read {path}: {error.strerror}; give the path of an existing file"
        ) from error
