"""A recording in parts: each opens alone, and a part that fails is not the end of the recording."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Protocol

from acquisition.clocks.clock_sample import ClockSample
from acquisition.errors import StreamError
from acquisition.messages.codec import DepthFormat, Recordable
from acquisition.messages.frames import StaticTransform
from acquisition.recording.intake import Stamped
from acquisition.stream.index_store import IndexStore
from acquisition.stream.open_part import NEVER, OpenPart, PartLimits, expected_index_bytes
from acquisition.stream.parts import PART_NAME
from acquisition.stream.writer import CHUNK_SIZE_BYTES, StreamWriter, with_source
from drivers.source import SourceInfo

STATISTICS_NAME = "terravibe.statistics"


@dataclass(frozen=True, slots=True)
class Head:
    """What every part begins with.

    Attributes:
        recording: a name that all parts of one recording share.
        sources: what is there at the start.
        extra_types: what the recorder itself has to say.
        static_transforms: where the frames sit.
        settings: the resolved configuration, as JSON values.
        statistics: gives the record that ends each part: how much came and how much was lost.
        depth_format: how depth frames are written.
    """

    recording: str
    sources: Sequence[SourceInfo]
    extra_types: Sequence[type[Recordable]]
    static_transforms: Sequence[StaticTransform]
    settings: Mapping[str, object]
    statistics: Callable[[], Mapping[str, str]]
    depth_format: DepthFormat = "raw"


class PartStore(Protocol):
    """Where the parts go."""

    def next_output(self) -> Path | BinaryIO:
        """Return where the next part goes.

        Raises:
            StreamError: there is no place for it.
        """

    def finished(self, first_ns: int, last_ns: int) -> None:
        """Take note that the part is complete, from the first to the last log time."""

    def failed(self, error: StreamError, *, empty: bool) -> None:
        """Take note that the part could not be continued; its place is not to be used again.

        Args:
            error: why.
            empty: nothing is in it.

        Raises:
            StreamError: there is no other place.
        """


class SplitWriter:
    """Writes items to one part after the other.

    Attributes:
        bytes_by_type: size of what was written before compression, for each type.
        refused: items that no message can express, for each type.
        refusal: why the last of them could not be written, or "".
        bytes_written: length of all parts so far.
    """

    def __init__(self, store: PartStore, head: Head, limits: PartLimits) -> None:
        """Begin the first part.

        Raises:
            StreamError: there is no place for it, or two sources produce the same type.
        """
        self.bytes_by_type: Counter[type[Recordable]] = Counter()
        self.refused: Counter[type[Recordable]] = Counter()
        self.refusal = ""
        self._finished_bytes = 0
        self._finished_items = 0
        self._store = store
        self._head = head
        self._sources = list(head.sources)
        self._limits = limits
        self._number = 0
        self._between_parts = False
        self._index = IndexStore(expected_index_bytes(limits))
        # What is wrong with the head is found here; from now on only an output can fail.
        with self._writer_to(io.BytesIO()) as trial:
            trial.write(ClockSample(0, "", 0, 0, 0, "", 0))  # the transforms go before it
        self._part = self._begin()

    @property
    def flushed(self) -> int:
        """Items that are in complete chunks, of all parts."""
        return self._finished_items + (0 if self._between_parts else self._part.flushed)

    @property
    def bytes_written(self) -> int:
        """Length of all parts so far."""
        in_progress = 0 if self._between_parts else self._part.writer.bytes_written
        return self._finished_bytes + in_progress

    def _begin(self) -> OpenPart:
        """Begin a part in the first place that takes it."""
        while True:
            output = self._store.next_output()
            try:
                writer = self._writer_to(output)
                self._identify(writer)
            except StreamError as error:
                self._store.failed(error, empty=True)
                continue
            self._number += 1
            self._between_parts = False
            return OpenPart(writer, self._limits)

    def _identify(self, writer: StreamWriter) -> None:
        identity = {"recording": self._head.recording, "part": str(self._number)}
        try:
            writer.add_metadata(PART_NAME, identity)
        except StreamError:
            writer.close()
            raise

    def _writer_to(self, output: Path | BinaryIO) -> StreamWriter:
        return StreamWriter(
            output,
            sources=self._sources,
            static_transforms=self._head.static_transforms,
            settings=self._head.settings,
            extra_types=self._head.extra_types,
            depth_format=self._head.depth_format,
            flush_interval_ns=NEVER,
            chunk_size_bytes=NEVER,
            index=self._index,
        )

    def write(self, items: Sequence[Stamped]) -> None:
        """Write items in this order and flush them.

        Raises:
            StreamError: the output failed, and there is no other place to go on.
        """
        self._append(items)
        self._flush()

    def _append(self, items: Sequence[Stamped]) -> None:
        """Write items to the chunk in progress, or a full one's successor."""
        sizes = self.bytes_by_type
        for item in items:
            log_time_ns, record, sequence = item
            if log_time_ns >= self._part.ends_ns:
                self._flush()
                self.begin_part()
            part = self._part
            try:
                size_bytes = part.writer.write(record, log_time_ns, log_time_ns, sequence)
            except StreamError as error:
                # With chunks closed by `_flush` alone, this is never the output's fault.
                self.refused[type(record)] += 1
                self.refusal = str(error)
                continue
            sizes[type(record)] += size_bytes
            part.took(item, size_bytes)
            if part.pending_bytes >= CHUNK_SIZE_BYTES:
                self._flush()

    def _flush(self) -> None:
        try:
            self._part.flush()
        except StreamError as error:
            self._go_on_elsewhere(error)

    def _go_on_elsewhere(self, error: StreamError) -> None:
        """Write what is in no complete chunk to the next place; each place is tried once."""
        unwritten = self._part.pending
        self._close_failed(error)
        self._part = self._begin()
        self._append(unwritten)
        self._flush()

    def _close_failed(self, error: StreamError) -> None:
        self._leave_part()
        self._part.writer.close()
        self._store.failed(error, empty=self._part.flushed == 0)

    def begin_part(self) -> None:
        """End the part with its statistics and index, and begin another.

        Raises:
            StreamError: there is no place for it.
        """
        self._end_part()
        self._part = self._begin()

    def _end_part(self) -> None:
        part = self._part
        try:
            part.writer.add_metadata(STATISTICS_NAME, self._head.statistics())
            part.writer.close()
        except StreamError as error:
            self._close_failed(error)
            return
        self._leave_part()
        self._store.finished(part.first_ns, part.last_ns)

    def _leave_part(self) -> None:
        self._finished_bytes += self._part.writer.bytes_written
        self._finished_items += self._part.flushed
        self._between_parts = True

    def add_source(self, info: SourceInfo) -> None:
        """Announce a source; see `StreamWriter.add_source`.

        Raises:
            StreamError: another source produces the same type, or the output failed.
        """
        try:
            self._part.writer.add_source(info)
        except StreamError as error:
            if not self._part.writer.failed:
                raise
            self._sources = with_source(self._sources, info)
            self._go_on_elsewhere(error)
            return
        self._sources = with_source(self._sources, info)

    def close(self) -> None:
        """End the last part; harmless after a failure.

        Raises:
            StreamError: its end could not be written.
        """
        if not self._between_parts:
            self._end_part()
