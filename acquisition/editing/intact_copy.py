"""Sound recordings into a new one: messages in the order given, metadata and attachments whole."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain, count
from pathlib import Path

from acquisition.editing.intact_recording import Defined, IntactRecording
from acquisition.editing.recording_copy import RecordingCopy
from acquisition.files import written_name

Progress = Callable[[float], object]
_NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True)
class CopyReport:
    """What is in the recording that was made.

    Attributes:
        output: where it is.
        messages: how many on each topic.
        start_ns: the earliest log time.
        end_ns: the latest log time.
        notes: what should be known about it, one line each.
    """

    output: str
    messages: dict[str, int]
    start_ns: int
    end_ns: int
    notes: tuple[str, ...]

    def as_json(self) -> dict[str, object]:
        """Return the report as JSON values, under the names of its attributes."""
        return asdict(self)

    def describe(self) -> list[str]:
        """Return the report as lines for people."""
        duration_s = (self.end_ns - self.start_ns) / _NS_PER_S
        lines = [f"{self.output}: {sum(self.messages.values())} messages, {duration_s:.3f} s"]
        lines += [f"  {topic}: {number}" for topic, number in self.messages.items()]
        return [*lines, *self.notes]


class IntactCopy:
    """Copies into a `RecordingCopy`, and counts.

    Attributes:
        counts: messages so far, by topic.
    """

    def __init__(
        self,
        copy: RecordingCopy,
        recordings: Sequence[IntactRecording],
        topics: Collection[str] | None = None,
    ) -> None:
        """Define the channels, whether there are messages on them or not.

        Args:
            copy: where everything goes.
            recordings: whose channels; of several, those that agree in everything become one.
            topics: those that are wanted; all by default.

        Raises:
            StreamError: the output refused it.
        """
        self.counts: Counter[str] = Counter()
        self._copy = copy
        self._names: dict[str, dict[str, str]] = {}
        self._start_ns: int | None = None
        self._end_ns = 0
        # By identity: the recordings hand out the same object with every message.
        self._numbers: dict[int, int] = {}
        for channel, schema in chain(*(recording.channels() for recording in recordings)):
            if topics is None or channel.topic in topics:
                one = channel if len(recordings) == 1 else replace(channel, id=0)
                self._numbers[id(channel)] = copy.define(one, schema)

    def keep(self, recording: IntactRecording) -> None:
        """Copy metadata and attachments.

        A metadata record whose name was used before with other content gets the file's name
        behind its own, because readers know records by name.

        Raises:
            StreamError: the recording is damaged, or the output refused it.
        """
        file = written_name(recording.path)
        for record in recording.metadata():
            others = chain([f" ({file})"], (f" ({file}, {number})" for number in count(2)))
            name = record.name
            while self._names.setdefault(name, record.metadata) != record.metadata:
                name = record.name + next(others)
            self._copy.metadata(name, record.metadata)
        for attachment in recording.attachments():
            self._copy.attachment(attachment)

    def messages(
        self, said: Iterable[Defined], start_ns: int, end_ns: int, progress: Progress
    ) -> None:
        """Copy messages.

        Args:
            said: the messages, in order.
            start_ns: the log time at which they start, for the progress.
            end_ns: the log time at which they end, for the progress.
            progress: called with the part of the work that is done, 0 to 1.

        Raises:
            StreamError: the recording is damaged, or the output refused it.
        """
        span_ns = max(1, end_ns - start_ns)
        for found in said:
            self._copy.message(self._numbers[id(found.channel)], found.message)
            self.counts[found.channel.topic] += 1
            log_time_ns = found.message.log_time
            if self._start_ns is None:
                self._start_ns = log_time_ns
            self._end_ns = log_time_ns
            progress((log_time_ns - start_ns) / span_ns)

    def report(self, output: Path, notes: tuple[str, ...] = ()) -> CopyReport:
        """Return what was copied."""
        counts = dict(sorted(self.counts.items()))
        return CopyReport(str(output), counts, self._start_ns or 0, self._end_ns, notes)
