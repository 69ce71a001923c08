"""Where the parts of a recording go on disk: from folder to folder as they fill up or fail."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from acquisition.errors import OutputEndedError, StreamError
from acquisition.recording.disk_sync import DiskSync
from acquisition.stream.open_part import NO_LIMITS, PartLimits
from acquisition.stream.parts import part_path, parts_of

MB = 1_000_000


def free_bytes(folder: Path) -> int:
    """Return the room on the folder's disk.

    Raises:
        StreamError: there is no such folder.
    """
    try:
        return shutil.disk_usage(folder).free
    except OSError as error:
        raise StreamError(f"cannot record into {folder}: {error.strerror}") from error


@dataclass(frozen=True, slots=True)
class DiskSettings:
    """How a recording is put on disk.

    Attributes:
        fallback_folders: where to go on when the folder before is full or fails.
        limits: when a part ends.
        reserve_bytes: room to leave on each disk, for the system and for ending the file well.
        sync_interval_s: at most so much is lost to a power cut, once the disk keeps up.
    """

    fallback_folders: tuple[Path, ...] = ()
    limits: PartLimits = NO_LIMITS
    reserve_bytes: int = 500 * MB
    sync_interval_s: float = 1.0


class FolderStore:
    """Hands out the paths of the parts; a folder that is full or failed is not used again.

    Attributes:
        left: why folders are not used any more.
        sync: keeps the parts on the disk.
    """

    def __init__(self, path: Path, settings: DiskSettings, free: Callable[[Path], int]) -> None:
        """Create nothing yet.

        Raises:
            StreamError: a name that the recording will need is taken.
        """
        self.left: list[str] = []
        if settings.limits != NO_LIMITS or settings.fallback_folders:
            _refuse_older_parts(path, settings.fallback_folders)
        self.sync = DiskSync(settings.sync_interval_s)
        self._path = path
        # Where each part lies, from which follows its name: a path of its own for each part would
        # be what makes a recording of days grow.
        self._parts: list[Path] = []
        self._folders = [path.parent, *settings.fallback_folders]
        self._reserve_bytes = settings.reserve_bytes
        self._free = free

    def free_bytes(self) -> int:
        """Return the room in the folder in use; StreamError when it is gone."""
        return self._free(self._folders[0])

    def next_output(self) -> Path:
        """Create the next part in the first folder that takes it; see `PartStore`."""
        name = part_path(self._path, len(self._parts)).name
        while problem := self.problem() or self._refusal(name):
            self._leave(problem)
        path = self._folders[0] / name
        self._parts.append(self._folders[0])
        self.sync.follow(path)
        return path

    def files(self) -> tuple[Path, ...]:
        """Return the parts so far."""
        return tuple(
            [f / part_path(self._path, number).name for number, f in enumerate(self._parts)]
        )

    def _refusal(self, name: str) -> str:
        """Create a file in the folder in use; return why that is not possible, or ""."""
        path = self._folders[0] / name
        try:
            path.touch(exist_ok=False)
        except FileExistsError:
            raise StreamError(f"{path} exists already; give the recording another name") from None
        except OSError as error:
            return f"cannot write {path}: {error.strerror}"
        return ""

    def problem(self) -> str:
        """Return why nothing more can go into the folder in use, or ""."""
        try:
            free = self.free_bytes()
        except StreamError as error:
            return str(error)
        if free > self._reserve_bytes:
            return ""
        return (
            f"{self._folders[0]} has {free // MB} MB left, the reserve is "
            f"{self._reserve_bytes // MB} MB"
        )

    def finished(self, first_ns: int, last_ns: int) -> None:
        """A part on disk needs no further care."""

    def failed(self, error: StreamError, *, empty: bool) -> None:
        """Leave the folder, and nothing in it that holds no message.

        Raises:
            OutputEndedError: it was the last one.
        """
        if empty:
            self.sync.forget()
            with suppress(OSError):  # the folder may be gone altogether
                self.files()[-1].unlink()
            del self._parts[-1]
        self._leave(str(error))

    def _leave(self, reason: str) -> None:
        self.left.append(reason)
        if len(self._folders) == 1:
            raise OutputEndedError(
                f"{reason}; the recording ends, what was flushed is readable; make room or give "
                "a fallback folder"
            )
        del self._folders[0]


def _refuse_older_parts(path: Path, fallback_folders: Sequence[Path]) -> None:
    """Find out now, not at the first split, that an older recording has the name."""
    try:
        older = parts_of(path, fallback_folders)[0]
    except StreamError:
        return
    raise StreamError(f"{older} exists already; give the recording another name")
