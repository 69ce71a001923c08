"""Compiled functions: where numba keeps them, and whether they are there."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path


def are_cached(kernels: Sequence[object]) -> bool:
    """Tell whether functions of numba's were compiled earlier by this installation."""
    return all(any(map(_is_newer, _indices(kernel))) for kernel in kernels)


def note_use(kernels: Sequence[object]) -> None:
    """Give the index files the time of now, where that is permitted.

    numba goes by the content of the source: an index that is older than its source, as after a
    checkout, may have served all the same.
    """
    for kernel in kernels:
        for pair in _indices(kernel):
            if not _is_newer(pair):
                with contextlib.suppress(OSError):  # of another user, or on a read-only disk
                    pair[0].touch()


def _indices(kernel: object) -> list[tuple[Path, Path]]:
    """Return numba's index files of a kernel, each with the kernel's source."""
    function = kernel.py_func  # type: ignore[attr-defined] # numba has no type information
    folder = Path(kernel.stats.cache_path)  # type: ignore[attr-defined]
    source = Path(function.__code__.co_filename)
    pattern = f"{source.stem}.{function.__name__}-*.nbi"
    return [(index, source) for index in folder.glob(pattern)]


def _is_newer(pair: tuple[Path, Path]) -> bool:
    index, source = pair
    return index.stat().st_mtime >= source.stat().st_mtime
