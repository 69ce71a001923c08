"""A finite source, such as a folder of images, into one recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from acquisition.errors import StreamError
from acquisition.files import check_target, replacing
from acquisition.messages.frames import StaticTransform
from acquisition.stream.writer import StreamWriter
from drivers.errors import EndOfSource
from drivers.samples import Sample
from drivers.source import Source, SourceInfo

_READ_TIMEOUT_S = 1.0


@dataclass(frozen=True, slots=True)
class ImportSummary:
    """What was imported.

    Attributes:
        info: from where.
        path: the recording.
        samples: how many, of each type by its name.
        duration_s: from the earliest to the latest sample.
        size_bytes: length of the recording.
    """

    info: SourceInfo
    path: Path
    samples: Mapping[str, int]
    duration_s: float
    size_bytes: int

    def as_json(self) -> dict[str, object]:
        """Return what a program wants to know."""
        return {
            "output": str(self.path),
            "source": self.info.name,
            "model": self.info.model,
            "samples": dict(self.samples),
            "duration_s": self.duration_s,
            "bytes": self.size_bytes,
        }

    def describe(self) -> list[str]:
        """Return lines for people."""
        total = sum(self.samples.values())
        return [f"{self.path}: {total} samples of {self.duration_s:.3f} s, {self.size_bytes} bytes"]


def record_all(
    source: Source,
    path: Path,
    *,
    static_transforms: Sequence[StaticTransform],
    settings: Mapping[str, object],
    progress: Callable[[int], None] | None = None,
    when_complete: Callable[[], object] = lambda: None,
) -> ImportSummary:
    """Write everything that the source gives to a recording, which appears when it is complete.

    Args:
        source: a finite source that is not open; it is closed again on every way out.
        path: the recording.
        static_transforms: where the frames sit.
        settings: the resolved configuration, as JSON values.
        progress: called with the number of samples so far, after each read.
        when_complete: called when all is written, before the recording appears under its name;
            what it raises keeps the recording from appearing.

    Raises:
        DriverError: the source failed.
        StreamError: the recording cannot be written, or there is nothing to record.
    """
    check_target(path)  # before the source is opened, which may be long work
    tally = _Tally()
    try:
        info = source.open()
        with replacing(path) as temporary:
            with StreamWriter(
                temporary, sources=[info], static_transforms=static_transforms, settings=settings
            ) as writer:
                for batch in _batches(source):
                    for sample in batch:
                        writer.write(sample)
                        tally.add(sample)
                    if progress is not None:
                        progress(tally.samples.total())
            if not tally.samples:
                raise StreamError(f"{info.name} holds no samples; nothing was written to {path}")
            when_complete()
    finally:
        source.close()
    size_bytes = path.stat().st_size
    return ImportSummary(info, path, dict(tally.samples), tally.duration_s, size_bytes)


class _Tally:
    """Counts samples, and keeps the earliest and the latest time."""

    def __init__(self) -> None:
        self.samples: Counter[str] = Counter()
        self._ends_ns: tuple[int, int] | None = None

    def add(self, sample: Sample) -> None:
        """Count the next sample."""
        self.samples[type(sample).__name__] += 1
        first_ns, last_ns = self._ends_ns or (sample.t_ns, sample.t_ns)
        self._ends_ns = min(first_ns, sample.t_ns), max(last_ns, sample.t_ns)

    @property
    def duration_s(self) -> float:
        """Return the seconds from the earliest stamp to the latest; 0 without samples."""
        return (self._ends_ns[1] - self._ends_ns[0]) * 1e-9 if self._ends_ns else 0.0


def _batches(source: Source) -> Iterator[Sequence[Sample]]:
    while True:
        try:
            yield source.read(_READ_TIMEOUT_S)
        except EndOfSource:
            return
