"""Records the full load until it is killed: the child of `benchmarks.recorder_kill`.

    python -m benchmarks.recorder_victim OUT.mcap STAMPS

The last stamp of every source is kept in the file STAMPS, which outlives the process, so that
the parent knows what was there to be recorded when the kill came.
"""

from __future__ import annotations

import mmap
import struct
import sys
from collections.abc import Sequence
from pathlib import Path
from threading import Event

from acquisition.clocks.host_clock import HostClock
from acquisition.recording.disk_output import DiskOutput
from acquisition.recording.folder_store import DiskSettings
from acquisition.recording.recorder import Recorder
from benchmarks.load import sources
from drivers.faults import Faults
from drivers.samples import Sample
from drivers.source import SourceInfo
from tests.fakes.paced_source import PacedSource

SLOT = struct.Struct("<Q")
SOURCES = 5


class WatchedSource:
    """A paced source whose last stamp, in log time, can be read from outside."""

    def __init__(self, source: PacedSource, stamps: mmap.mmap, slot: int, clock: HostClock) -> None:
        self.name = source.name
        self._source = source
        self._stamps = stamps
        self._at = slot * SLOT.size
        self._clock = clock

    @property
    def faults(self) -> Faults:
        """Those of the source."""
        return self._source.faults

    def open(self) -> SourceInfo:
        """Open the source."""
        return self._source.open()

    def read(self, timeout_s: float) -> Sequence[Sample]:
        """Read the source, and leave the stamp where the parent finds it."""
        samples = self._source.read(timeout_s)
        for sample in samples:
            SLOT.pack_into(self._stamps, self._at, self._clock.log_time_ns(sample.t_ns))
        return samples

    def close(self) -> None:
        """Close the source."""
        self._source.close()


def main() -> None:
    """Record until killed."""
    out, stamps_path = map(Path, sys.argv[1:3])
    clock = HostClock()
    with stamps_path.open("r+b") as file, mmap.mmap(file.fileno(), 0) as stamps:
        watched = [WatchedSource(s, stamps, i, clock) for i, s in enumerate(sources())]
        output = DiskOutput(out, DiskSettings(reserve_bytes=0))
        Recorder(watched, output, clock=clock).run(Event())


if __name__ == "__main__":
    main()
