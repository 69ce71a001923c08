"""What the recorder writes to: a disk, or a ring in memory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from acquisition.messages.codec import Recordable
from acquisition.recording.intake import Stamped
from acquisition.stream.split_writer import Head
from drivers.source import SourceInfo


@dataclass(frozen=True, slots=True)
class OutputState:
    """What became of the items so far.

    Attributes:
        bytes_written: length of the recording.
        flushed: items that are in complete chunks.
        free_bytes: room where it goes.
        bytes_by_type: size before compression, for each type.
        refused: items that no message can express, for each type.
        warnings: what is wrong with the output, one line each.
    """

    bytes_written: int
    flushed: int
    free_bytes: int
    bytes_by_type: Counter[type[Recordable]]
    refused: Counter[type[Recordable]]
    warnings: tuple[str, ...]


class RecordingOutput(Protocol):
    """What the recorder writes to. All calls come from the recording thread."""

    def start(self, head: Head) -> None:
        """Begin; nothing is created before.

        Raises:
            StreamError: there is no place for the recording.
        """

    def write(self, items: Sequence[Stamped]) -> None:
        """Write and flush.

        Raises:
            StreamError: the output has failed for good.
        """

    def add_source(self, info: SourceInfo) -> None:
        """Announce a source that turned up late.

        Raises:
            StreamError: another source produces the same type, or the output failed for good.
        """

    def tend(self) -> None:
        """Do what is due once a second.

        Raises:
            OutputEndedError: the room that is left is the reserve.
        """

    def state(self) -> OutputState:
        """Return what became of the items so far."""

    def files(self) -> tuple[Path, ...]:
        """Return the recording's files so far, in order; those of a failed one too."""

    def close(self) -> tuple[Path, ...]:
        """Complete the recording; return its files, in order. Harmless when not started.

        Raises:
            StreamError: its end could not be written, or not all of it.
        """
