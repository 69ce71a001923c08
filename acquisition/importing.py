"""A finite source, such as a folder of images, into one recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
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
    """What was imported: from where, and how many samples."""

    info: SourceInfo
    samples: int


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
    samples = 0
    try:
        info = source.open()
        with _told_by_name(path), replacing(path) as temporary:
            with StreamWriter(
                temporary, sources=[info], static_transforms=static_transforms, settings=settings
            ) as writer:
                for batch in _batches(source):
                    for sample in batch:
                        writer.write(sample)
                    samples += len(batch)
                    if progress is not None:
                        progress(samples)
            if not samples:
                raise StreamError(f"{info.name} holds no samples; nothing was written to {path}")
            when_complete()
    finally:
        source.close()
    return ImportSummary(info, samples)


@contextmanager
def _told_by_name(path: Path) -> Iterator[None]:
    """Let what the system refused be told of the product, not of its temporary file."""
    try:
        yield
    except StreamError as error:
        if isinstance(error.__cause__, OSError):
            reason = error.__cause__.strerror
            raise StreamError(f"cannot write {path}: {reason}; nothing of it is kept") from error
        raise


def _batches(source: Source) -> Iterator[Sequence[Sample]]:
    while True:
        try:
            yield source.read(_READ_TIMEOUT_S)
        except EndOfSource:
            return
