"""From the operating system's memory to the disk: what a power cut may take.

What was flushed survives the death of the program. A power cut takes in addition what the system
has not yet put on the disk, which by itself it does after up to 30 s. So the file being written
is synchronised at an interval, in a thread of its own, because the disk may take seconds for it.
"""

from __future__ import annotations

import os
from pathlib import Path
from threading import Event, Lock, Thread

from acquisition.files import synchronise


class DiskSync:
    """Synchronises the file that is being written, and once more each file that is finished.

    Attributes:
        error: why an attempt failed first, or "". It stays, because the system tells only once
            that the disk refused what was written.
    """

    def __init__(self, interval_s: float) -> None:
        """Start the thread; it ends with `close`."""
        self.error = ""
        self._interval_s = interval_s
        self._lock = Lock()
        self._current: Path | None = None
        self._removed: Path | None = None
        self._finished: list[Path] = []
        self._stop = Event()
        self._thread = Thread(target=self._live, name="disk sync", daemon=True)
        self._thread.start()

    def follow(self, path: Path) -> None:
        """Synchronise this file from now on; the one before is finished."""
        with self._lock:
            if self._current is not None:
                self._finished.append(self._current)
            self._current = path

    def forget(self) -> None:
        """Leave the current file alone: it is about to be removed."""
        with self._lock:
            self._removed, self._current = self._current, None

    def close(self) -> None:
        """Synchronise everything a last time and end the thread."""
        self._stop.set()
        self._thread.join()

    def _live(self) -> None:
        while not self._stop.wait(self._interval_s):
            self._synchronise_all()
        self._synchronise_all()

    def _synchronise_all(self) -> None:
        with self._lock:
            paths = [*self._finished, *([self._current] if self._current else [])]
            self._finished.clear()
        for path in paths:
            problem = _problem(path)
            if path != self._removed:
                self.error = self.error or problem


def _problem(path: Path) -> str:
    """Synchronise a file and its name in the folder; return why that failed, or ""."""
    try:
        synchronise(path, os.O_RDONLY)
        synchronise(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        return f"cannot synchronise {path}: {error.strerror}"
    return ""
