"""What goes wrong with a world's folder, in words."""

from __future__ import annotations

import os
from pathlib import Path

from acquisition.errors import StreamError
from mapping.errors import MappingError


def no_world(path: Path) -> MappingError:
    """Say why what is at `path` was not found to be a world."""
    if not path.exists():
        return MappingError(f"there is no world at {path}; check the name")
    if path.is_dir() and not os.access(path, os.R_OK | os.X_OK):
        return unreadable(path)
    return MappingError(f"{path} is no world map; give a folder made by 'terravibe map --world'")


def unreadable(path: Path) -> MappingError:
    """Say that a world may not be read."""
    return MappingError(f"no permission to read the world {path}; ask its owner for it")


def unwritable(path: Path, error: OSError | StreamError) -> MappingError:
    """Say that a world could not be changed, and is as before."""
    return MappingError(
        f"cannot write to the world {path}: {reason(error)}; free some space or give a writable "
        "folder; what was saved before is whole"
    )


def reason(error: OSError | StreamError) -> str:
    """Return what the system, or who asked it, has to say."""
    return str((isinstance(error, OSError) and error.strerror) or error)
