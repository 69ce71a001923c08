"""One writer at a time."""

from __future__ import annotations

import fcntl
from pathlib import Path
from typing import IO

from mapping.errors import MappingError

LOCK_FILE = "writer.lock"


def locked(path: Path) -> IO[bytes]:
    """Return the lock of a world's folder; the system lets go of it however the process ends.

    Raises:
        MappingError: another process has it, or the folder cannot be written.
    """
    try:
        lock = (path / LOCK_FILE).open("wb")
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
