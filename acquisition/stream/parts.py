"""The parts of a split recording: their names, and how they are read as one stream."""

from __future__ import annotations

import heapq
import re
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

from acquisition.errors import StreamError
from acquisition.stream.byte_source import FinishedFile
from acquisition.stream.reader import StreamMessage, StreamReader

PART_NAME = "terravibe.part"  # the metadata record that names recording and part


def part_path(path: Path, number: int) -> Path:
    """Return the path of a part: NAME.mcap, then NAME_001.mcap and so on.

    So a recording has the name that it was given, and no file changes its name when a second part
    follows.
    """
    if number == 0:
        return path
    return path.with_name(f"{path.stem}_{number:03d}{path.suffix}")


def parts_of(path: Path, fallback_folders: Sequence[Path] = ()) -> list[Path]:
    """Return the parts that are there of a recording, in order.

    Args:
        path: the name under which it was recorded, which is that of its first part.
        fallback_folders: where else parts may be.

    Raises:
        StreamError: there are none.
    """
    pattern = re.compile(rf"{re.escape(path.stem)}(?:_(\d{{3,}}))?{re.escape(path.suffix)}")
    found: list[tuple[int, Path]] = []
    for folder in (path.parent, *fallback_folders):
        for candidate in folder.glob(f"*{path.suffix}"):
            match = pattern.fullmatch(candidate.name)
            if match:
                found.append((int(match[1] or 0), candidate))
    if not found:
        raise StreamError(f"no recording {path} and no part of it")
    return [part for _, part in sorted(found)]


def read_parts(paths: Sequence[Path]) -> Iterator[StreamMessage]:
    """Give the messages of all parts in order of log time, as if they were one recording.

    Raises:
        StreamError: a part cannot be read, or belongs to another recording.
    """
    with ExitStack() as stack:
        readers = [StreamReader(stack.enter_context(FinishedFile(path))) for path in paths]
        streams = [
            _checked(reader, path, readers[0]) for reader, path in zip(readers, paths, strict=True)
        ]
        yield from heapq.merge(*streams, key=lambda message: message.log_time_ns)


def _checked(reader: StreamReader, path: Path, first: StreamReader) -> Iterator[StreamMessage]:
    for number, message in enumerate(reader):
        if number == 0:
            names = [r.metadata.get(PART_NAME, {}).get("recording", "") for r in (first, reader)]
            if names[0] != names[1]:
                raise StreamError(
                    f"{path} is no part of recording {names[0]!r} but of {names[1]!r}"
                )
        yield message
