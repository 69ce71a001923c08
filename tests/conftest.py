"""Shared fixtures: real data, and a guard that nothing outlives a test."""

from __future__ import annotations

import gc
import os
import threading
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import pytest

# No deadline: the first example may compile kernels, and CI machines are shared.
hypothesis.settings.register_profile("terravibe", deadline=None)
hypothesis.settings.load_profile("terravibe")


def pytest_collection_finish() -> None:
    """Leave what the imports made out of the search for cycles: it stays for the whole run.

    A third of a million objects, through which every full collection would go again.
    """
    gc.collect()
    gc.freeze()


_SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


def _open_descriptors() -> dict[str, str]:
    """Return descriptor -> target of this process."""
    found: dict[str, str] = {}
    for entry in Path("/proc/self/fd").iterdir():
        try:
            found[entry.name] = str(entry.readlink())
        except FileNotFoundError:  # the descriptor of this very listing
            continue
    return found


@pytest.fixture(autouse=True)
def nothing_outlives_a_test() -> Iterator[None]:
    """Fail a test that leaves a thread or a file descriptor behind."""
    threads_before = set(threading.enumerate())
    descriptors_before = _open_descriptors()
    yield
    if _survivors(threads_before, descriptors_before):
        gc.collect()  # 0.1 s: only where something may hang in a cycle
    survivors = _survivors(threads_before, descriptors_before)
    assert not survivors, f"outlived the test: {survivors}"


def _survivors(threads: set[threading.Thread], descriptors: dict[str, str]) -> list[str]:
    """Return the threads and descriptors that are there now and were not before."""
    running = [t for t in threading.enumerate() if t not in threads and t.is_alive()]
    opened = [
        f"descriptor {fd} of {target}"
        for fd, target in _open_descriptors().items()
        if descriptors.get(fd) != target and not _belongs_to_a_library(target)
    ]
    return [*(f"thread {t.name}" for t in running), *opened]


def _belongs_to_a_library(target: str) -> bool:
    """Tell a descriptor that a library keeps for the life of the process."""
    return (
        target.startswith(("/usr/share/fonts", "/dev/urandom"))
        or target.endswith("/proj.db")  # GDAL's table of reference systems
        or "matplotlib" in target
    )


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Return the folder of real recordings, or skip with the reason."""
    folder = Path(os.environ.get("TERRAVIBE_DATA", _SHARED_DATA))
    if not folder.is_dir():
        pytest.skip(f"real data not found at {folder}; set TERRAVIBE_DATA to its folder")
    return folder
