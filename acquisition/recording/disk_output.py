"""A recording on disk."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from acquisition.errors import StreamError
from acquisition.recording.folder_store import DiskSettings, FolderStore, free_bytes
from acquisition.recording.intake import Stamped
from acquisition.recording.output import OutputState
from acquisition.stream.split_writer import Head, SplitWriter
from drivers.source import SourceInfo


class DiskOutput:
    """A recording on disk: NAME.mcap, then NAME_001.mcap and so on where it is split."""

    def __init__(
        self,
        path: Path,
        settings: DiskSettings | None = None,
        *,
        free: Callable[[Path], int] = free_bytes,
    ) -> None:
        """Touch nothing yet.

        Args:
            path: the recording, or what its parts are named after.
            settings: how it is put on disk.
            free: tells how much room a folder has.
        """
        self._path = path
        self._settings = settings or DiskSettings()
        self._free = free
        self._store: FolderStore | None = None
        self._writer: SplitWriter | None = None

    def start(self, head: Head) -> None:
        """See `RecordingOutput`."""
        self._store = FolderStore(self._path, self._settings, self._free)
        try:
            self._writer = SplitWriter(self._store, head, self._settings.limits)
        except StreamError:
            self._store.sync.close()
            raise

    def write(self, items: Sequence[Stamped]) -> None:
        """See `RecordingOutput`."""
        self._started()[1].write(items)

    def add_source(self, info: SourceInfo) -> None:
        """See `RecordingOutput`."""
        self._started()[1].add_source(info)

    def tend(self) -> None:
        """See `RecordingOutput`."""
        store, writer = self._started()
        if store.problem():
            writer.begin_part()

    def state(self) -> OutputState:
        """See `RecordingOutput`."""
        store, writer = self._started()
        try:
            free = store.free_bytes()
        except StreamError:
            free = 0  # the folder is gone; `tend` tells
        warnings = [*store.left, store.sync.error, writer.refusal]
        return OutputState(
            bytes_written=writer.bytes_written,
            flushed=writer.flushed,
            free_bytes=free,
            bytes_by_type=writer.bytes_by_type,
            refused=writer.refused,
            warnings=tuple([warning for warning in warnings if warning]),
        )

    def _started(self) -> tuple[FolderStore, SplitWriter]:
        if self._store is None or self._writer is None:
            raise StreamError(f"cannot write {self._path}: the recording was not started")
        return self._store, self._writer

    def files(self) -> tuple[Path, ...]:
        """See `RecordingOutput`."""
        return self._store.files() if self._store else ()

    def close(self) -> tuple[Path, ...]:
        """See `RecordingOutput`."""
        if self._store is None:
            return ()
        try:
            if self._writer is not None:
                self._writer.close()
        finally:
            self._store.sync.close()
        return self.files()
