"""Record a source and map the recording while it is being written."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from acquisition.messages.frames import StaticTransform
from acquisition.stream.byte_source import GrowingFile
from acquisition.stream.reader import StreamMessage, StreamReader
from acquisition.stream.writer import StreamWriter
from drivers.errors import EndOfSource
from drivers.source import Source
from mapping.session import MapOptions, MapResult, map_stream

_READ_TIMEOUT_S = 1.0


class _Recording(threading.Thread):
    """Writes everything that an open source gives, until it ends or `stop` is set."""

    def __init__(self, source: Source, writer: StreamWriter) -> None:
        super().__init__(name="recording", daemon=True)
        self._source = source
        self._writer = writer
        self.stop = threading.Event()
        self.failure: BaseException | None = None

    def run(self) -> None:
        """Read and write; the recording is closed properly on every way out."""
        try:
            with self._writer:
                self._copy()
        except BaseException as error:  # noqa: BLE001 - handed to the thread that waits
            self.failure = error

    def _copy(self) -> None:
        while not self.stop.is_set():
            try:
                samples = self._source.read(_READ_TIMEOUT_S)
            except EndOfSource:
                return
            for sample in samples:
                self._writer.write(sample)


def record_and_map(
    source: Source,
    recording: Path,
    *,
    static_transforms: Sequence[StaticTransform],
    settings: Mapping[str, object],
    options: MapOptions,
    progress: Callable[[StreamMessage], None] = lambda _: None,
) -> MapResult:
    """Record a finite source into an MCAP file and map that file while it grows.

    The recording keeps its name from the start, so that others can follow it too; it stays
    readable if the mapper fails.

    Raises:
        DriverError, StreamError: the source or the recording failed.
        MappingError: nothing could be mapped.
    """
    try:
        info = source.open()
        writer = StreamWriter(
            recording, sources=[info], static_transforms=static_transforms, settings=settings
        )
        thread = _Recording(source, writer)
        thread.start()
        try:
            result = _follow(recording, thread, options, progress)
        finally:
            thread.stop.set()
            thread.join()
    finally:
        source.close()
    if thread.failure is not None:
        raise thread.failure
    return result


def _follow(
    recording: Path,
    thread: _Recording,
    options: MapOptions,
    progress: Callable[[StreamMessage], None],
) -> MapResult:
    """Map until the footer, or until the recording has failed."""
    with GrowingFile(recording, stop=lambda: thread.failure is not None) as growing:
        return map_stream(StreamReader(growing), options, progress)
