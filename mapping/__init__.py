"""mapping: a stream of poses and depth frames in, an elevation map with variance out.

Knows nothing of devices or of files that are being recorded.
"""

import os
import tempfile
from pathlib import Path

# Start-up compares this with "terravibe" to notice another distribution's `mapping`.
DISTRIBUTION = "terravibe"


def _private_folder() -> str:
    """Return a folder under the temporary one that nobody else can write to."""
    folder = Path(tempfile.gettempdir()) / f"terravibe-kernels-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.stat()
    private = status.st_uid == os.getuid() and not status.st_mode & 0o022
    return str(folder) if private else tempfile.mkdtemp(prefix="terravibe-kernels-")


def _can_keep_kernels() -> bool:
    """Tell whether numba finds a place by itself: beside the kernels, or in the user's cache."""
    user_cache = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))  # noqa: PTH111 - Path.expanduser fails without a home
    nearest = next(p for p in (user_cache, *user_cache.parents) if p.exists())
    return any(os.access(p, os.W_OK | os.X_OK) for p in (Path(__file__).parent, nearest))


# numba refuses to import a cached kernel when it can write neither beside the module nor in a
# home folder, as on a vehicle with a read-only root.
if "NUMBA_CACHE_DIR" not in os.environ and not _can_keep_kernels():
    os.environ["NUMBA_CACHE_DIR"] = _private_folder()
