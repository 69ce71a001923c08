"""Record a source and map the recording while it is being written."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

from acquisition.errors import StreamError
from acquisition.recording.disk_output import DiskOutput
from acquisition.recording.plan import RecordingPlan, RecordingResult
from acquisition.recording.recorder import Recorder
from acquisition.stream.byte_source import GrowingFile
from acquisition.stream.reader import StreamMessage, StreamReader
from drivers.source import Source
from mapping.session import MapOptions, MapResult, map_stream

_LOOK_EVERY_S = 0.02


class _Recording(threading.Thread):
    """The recorder at work, until its source ends or `stop` is set."""

    def __init__(self, recorder: Recorder) -> None:
        super().__init__(name="recording", daemon=True)
        self._recorder = recorder
        self.stop = threading.Event()
        self.result: RecordingResult | None = None
        self.failure: BaseException | None = None

    @property
    def has_failed(self) -> bool:
        """Tell whether the recording will get no proper end."""
        failed = self.result is not None and self.result.outcome == "output_failed"
        return failed or self.failure is not None

    def run(self) -> None:
        """Record; what goes wrong is kept for the thread that waits."""
        try:
            self.result = self._recorder.run(self.stop)
        except BaseException as error:  # noqa: BLE001 - handed to the thread that waits
            self.failure = error

    def finish(self) -> None:
        """Stop, wait, and raise what ended the recording early or is missing from it."""
        self.stop.set()
        if self.ident is not None:
            self.join()
        if self.failure is not None:
            raise self.failure
        if self.result is None:  # never started
            return
        if self.result.outcome == "output_failed":
            raise StreamError(self.result.message)
        for source in self.result.health.sources:
            if source.queue.dropped:
                raise StreamError(
                    f"{source.name}: {source.queue.dropped} samples found no room in memory and "
                    "are not recorded; close other programs and try again"
                )


def record_and_map(
    source: Source,
    recording: Path,
    plan: RecordingPlan,
    options: MapOptions,
    progress: Callable[[StreamMessage], None] = lambda _: None,
) -> MapResult:
    """Record a finite source into a new MCAP file and map that file while it grows.

    The recording keeps its name from the start, so that others can follow it too; it stays
    readable if the mapper fails.

    Raises:
        RecorderError, StreamError: the source or the recording failed, or the file exists.
        MappingError: nothing could be mapped.
    """
    recorder = Recorder([source], DiskOutput(recording), plan)
    thread = _Recording(recorder)
    try:
        recorder.preflight()
        thread.start()
        return _follow(recording, thread, options, progress)
    finally:
        try:
            thread.finish()  # what went wrong there explains what went wrong here
        finally:
            recorder.close()


def _follow(
    recording: Path,
    thread: _Recording,
    options: MapOptions,
    progress: Callable[[StreamMessage], None],
) -> MapResult:
    """Map until the footer, or until the recording has failed."""
    while not recording.exists() and thread.is_alive():
        thread.join(_LOOK_EVERY_S)
    if thread.failure is not None:
        raise thread.failure
    with GrowingFile(recording, stop=lambda: thread.has_failed) as growing:
        return map_stream(StreamReader(growing), options, progress)
