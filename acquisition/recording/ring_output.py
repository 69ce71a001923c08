"""The last seconds in memory, written when something happens."""

from __future__ import annotations

import io
import re
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from threading import Event

from acquisition.errors import StreamError
from acquisition.files import replacing
from acquisition.recording.folder_store import MB, free_bytes
from acquisition.recording.intake import Stamped
from acquisition.recording.output import OutputState
from acquisition.stream.open_part import PartLimits
from acquisition.stream.parts import part_path
from acquisition.stream.split_writer import Head, SplitWriter
from drivers.source import SourceInfo

# The ring forgets whole parts, so it holds between 1 and 1 + 1/8 of what was asked for.
_PARTS = 8


@dataclass(frozen=True, slots=True)
class RingSettings:
    """What the ring holds.

    Attributes:
        duration_ns: the time before a trigger that is kept.
        memory_bytes: the most that it may take, compressed; the oldest goes first.
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
    """Keeps the last seconds in memory; `trigger` has them written as NAME_snap000.mcap, ...

    The numbers go on behind those that are there. Each snapshot is a recording in parts. What one
    holds is not in the next, so that snapshots in quick succession follow each other without
    overlap.
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
        self._next_number = 0
        self._triggered = Event()
        self._snapshots: list[Future[list[Path]]] = []
        # A disk may take longer for a snapshot than the queues last.
        self._background = ThreadPoolExecutor(max_workers=1, thread_name_prefix="snapshot")

    def trigger(self) -> None:
        """Have a snapshot written soon; may be called from any thread and from a signal."""
        self._triggered.set()

    def start(self, head: Head) -> None:
        """See `RecordingOutput`."""
        # A snapshot whose name is taken would be lost: what it holds has left the ring.
        self._next_number = _number_behind_all(self._path)
        self._writer = SplitWriter(self._store, head, self._settings.part_limits)

    def write(self, items: Sequence[Stamped]) -> None:
        """See `RecordingOutput`; a trigger takes effect behind these items."""
        writer = self._started()
        writer.write(items)
        if self._triggered.is_set():
            self._triggered.clear()
            writer.begin_part()
            number = self._next_number
            self._next_number += 1
            parts = self._store.take()
            self._snapshots.append(self._background.submit(self._write_snapshot, number, parts))

    def _write_snapshot(self, number: int, parts: Sequence[bytes]) -> list[Path]:
        path = self._path.with_stem(f"{self._path.stem}_snap{number:03d}")
        size_bytes = sum(map(len, parts))
        free = self._free(path.parent)
        if free - size_bytes < self._settings.reserve_bytes:
            raise StreamError(
                f"snapshot {path} of {size_bytes // MB} MB not written: {free // MB} MB are "
                f"free, the reserve is {self._settings.reserve_bytes // MB} MB"
            )
        files = [part_path(path, index) for index in range(len(parts))]
        for file, data in zip(files, parts, strict=True):
            _write_file(file, data)
        return files

    def add_source(self, info: SourceInfo) -> None:
        """See `RecordingOutput`."""
        self._started().add_source(info)

    def tend(self) -> None:
        """See `RecordingOutput`; there is nothing to do."""

    def state(self) -> OutputState:
        """See `RecordingOutput`; `bytes_written` is what the ring has taken in so far."""
        writer = self._started()
        done = [future for future in self._snapshots if future.done()]
        warnings = [str(error) for future in done if (error := future.exception())]
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

    def close(self) -> tuple[Path, ...]:
        """Wait for the snapshots; see `RecordingOutput`. What is still in the ring is given up.

        Raises:
            StreamError: a snapshot could not be written.
        """
        self._background.shutdown()
        return tuple(path for future in self._snapshots for path in future.result())


def _number_behind_all(path: Path) -> int:
    """Return the number of the next snapshot: behind those of older recordings of that name."""
    pattern = re.compile(rf"{re.escape(path.stem)}_snap(\d+)(?:_\d+)?{re.escape(path.suffix)}")
    matches = (pattern.fullmatch(file.name) for file in path.parent.glob(f"*{path.suffix}"))
    return max((int(match[1]) + 1 for match in matches if match), default=0)


def _write_file(path: Path, data: bytes) -> None:
    if path.exists():
        raise StreamError(f"{path} exists already; give the recording another name")
    try:
        with replacing(path) as temporary:
            temporary.write_bytes(data)
    except OSError as error:
        raise StreamError(f"cannot write {path}: {error.strerror}") from error
