"""The last seconds in memory, written when something happens."""

from __future__ import annotations

import io
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from acquisition.errors import StreamError
from acquisition.recording.folder_store import MB, free_bytes
from acquisition.recording.intake import Stamped
from acquisition.recording.output import OutputState
from acquisition.recording.snapshot_writer import SnapshotWriter
from acquisition.stream.open_part import PartLimits
from acquisition.stream.split_writer import Head, SplitWriter
from drivers.source import SourceInfo

# The ring forgets whole parts, so it holds between 1 and 1 + 1/8 of what was asked for.
_PARTS = 8


@dataclass(frozen=True, slots=True)
class RingSettings:
    """What the ring holds.

    Attributes:
        duration_ns: the time before a trigger that is kept.
        memory_bytes: the most that it may take, compressed; the oldest goes first. A snapshot
            that is being written takes at most as much again.
        reserve_bytes: a snapshot that would leave less on the disk is not written.
    """

    duration_ns: int
    memory_bytes: int = 512 * MB
    reserve_bytes: int = 500 * MB

    @property
    def part_limits(self) -> PartLimits:
        """When a part ends."""
        return PartLimits(self.memory_bytes // _PARTS, self.duration_ns // _PARTS)


@dataclass(frozen=True, slots=True)
class _KeptPart:
    data: bytes
    last_ns: int


class _MemoryStore:
    """Keeps finished parts, the oldest only as long as there is time and room for it."""

    def __init__(self, settings: RingSettings) -> None:
        self.parts: deque[_KeptPart] = deque()
        self.shortened = False
        self._settings = settings
        self._output = io.BytesIO()

    def next_output(self) -> io.BytesIO:
        """Return where the next part goes."""
        self._output = io.BytesIO()
        return self._output

    def finished(self, first_ns: int, last_ns: int) -> None:
        """Keep the part that ended, and drop what is too old or too much."""
        if first_ns < 0:
            return  # nothing in it
        self.parts.append(_KeptPart(self._output.getvalue(), last_ns))
        while last_ns - self.parts[0].last_ns > self._settings.duration_ns:
            self.parts.popleft()
        # Room for the part in progress is set aside.
        limit_bytes = self._settings.memory_bytes - self._settings.part_limits.size_bytes
        while len(self.parts) > 1 and self.size_bytes() > limit_bytes:
            self.parts.popleft()
            self.shortened = True

    def size_bytes(self) -> int:
        """Return the bytes of all parts that are kept."""
        return sum(len(part.data) for part in self.parts)

    def failed(self, error: StreamError, *, empty: bool) -> None:  # noqa: ARG002 - of `PartStore`
        """Give up: memory that cannot be written to has no second place."""
        raise error

    def take(self) -> list[bytes]:
        """Return the parts, oldest first, and keep none."""
        parts = [part.data for part in self.parts]
        self.parts.clear()
        return parts


class RingOutput:
    """Keeps the last seconds in memory; `trigger` has them written, see `SnapshotWriter`.

    Each snapshot is a recording in parts. What one holds is not in the next, so that snapshots in
    quick succession follow each other without overlap. A trigger while one is being written takes
    effect when that is done; nothing is lost by it unless that takes longer than the ring lasts.
    """

    def __init__(
        self,
        path: Path,
        settings: RingSettings,
        *,
        free: Callable[[Path], int] = free_bytes,
    ) -> None:
        """Touch nothing yet.

        Args:
            path: what the snapshots are named after.
            settings: what the ring holds.
            free: tells how much room a folder has.
        """
        self._path = path
        self._settings = settings
        self._free = free
        self._store = _MemoryStore(settings)
        self._writer: SplitWriter | None = None
        self._triggered = False
        self._snapshots = SnapshotWriter(path, settings.reserve_bytes, free)

    def trigger(self) -> None:
        """Have a snapshot written soon; may be called from any thread and from a signal."""
        self._triggered = True  # no `Event`: a handler that interrupts its methods hangs in them

    def start(self, head: Head) -> None:
        """See `RecordingOutput`."""
        self._snapshots.start()
        self._writer = SplitWriter(self._store, head, self._settings.part_limits)

    def write(self, items: Sequence[Stamped]) -> None:
        """See `RecordingOutput`; a trigger takes effect behind these items."""
        writer = self._started()
        writer.write(items)
        if self._triggered and not self._snapshots.is_busy():
            self._take_snapshot(writer)

    def _take_snapshot(self, writer: SplitWriter) -> None:
        self._triggered = False
        writer.begin_part()
        self._snapshots.submit(self._store.take())

    def add_source(self, info: SourceInfo) -> None:
        """See `RecordingOutput`."""
        self._started().add_source(info)

    def tend(self) -> None:
        """See `RecordingOutput`; there is nothing to do."""

    def state(self) -> OutputState:
        """See `RecordingOutput`; `bytes_written` is what the ring has taken in so far."""
        writer = self._started()
        self._snapshots.is_busy()  # if not, its outcome is known now
        warnings = [self._snapshots.problem()]
        if self._store.shortened:
            warnings.append("the ring is shorter than asked for: its memory is full")
        try:
            free = self._free(self._path.parent)
        except StreamError as error:
            warnings.append(str(error))
            free = 0
        return OutputState(
            bytes_written=writer.bytes_written,
            flushed=writer.flushed,
            free_bytes=free,
            bytes_by_type=writer.bytes_by_type,
            refused=writer.refused,
            warnings=tuple([text for text in (*warnings, writer.refusal) if text]),
        )

    def _started(self) -> SplitWriter:
        if self._writer is None:
            raise StreamError(f"cannot write {self._path}: the recording was not started")
        return self._writer

    def files(self) -> tuple[Path, ...]:
        """See `RecordingOutput`."""
        return self._snapshots.files()

    def close(self) -> tuple[Path, ...]:
        """Wait for the snapshots; see `RecordingOutput`. What is still in the ring is given up.

        Raises:
            StreamError: a snapshot could not be written.
        """
        self._snapshots.wait()
        if self._triggered and self._writer is not None:
            self._take_snapshot(self._writer)
        self._snapshots.close()
        if problem := self._snapshots.problem():
            raise StreamError(problem)
        return self.files()
