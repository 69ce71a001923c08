"""What should be known of recordings that are merged: what they hold twice, and what is missing."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise

from acquisition.editing.intact_recording import Defined, IntactRecording
from acquisition.stream.parts import PART_NAME


def part_notes(recordings: Iterable[IntactRecording]) -> tuple[str, ...]:
    """Return which parts are missing between those that are there, one line for each recording.

    Raises:
        StreamError: one is damaged.
    """
    seen: defaultdict[str, set[int]] = defaultdict(set)
    for recording in recordings:
        for record in recording.metadata():
            # A merged recording holds those of all its parts, with a file's name behind.
            part = record.metadata.get("part", "")
            if record.name.startswith(PART_NAME) and part.isdecimal():
                seen[record.metadata.get("recording", "")].add(int(part))
    missing = {name: ", ".join(_between(sorted(parts))) for name, parts in seen.items()}
    return tuple(
        f"of recording {name} these parts are missing: {listed}"
        for name, listed in missing.items()
        if listed
    )


def _between(parts: Sequence[int]) -> Iterator[str]:
    """Give what is missing between numbers, as the ends of the files' names."""
    for before, behind in pairwise(parts):
        if behind - before > 1:
            first, last = f"_{before + 1:03d}", f"_{behind - 1:03d}"
            yield first if first == last else f"{first} to {last}"


class Repeats:
    """Counts messages that more than one recording holds; all of them are copied."""

    def __init__(self) -> None:
        self._topics: Counter[str] = Counter()
        self._log_time_ns = -1
        self._first_in: dict[int, int] = {}  # message -> recording, of this log time

    def counted(self, said: Iterable[tuple[int, Defined]]) -> Iterator[Defined]:
        """Give messages on that come in order of log time, each with its recording's number."""
        for number, found in said:
            message = found.message
            if message.log_time != self._log_time_ns:
                self._log_time_ns = message.log_time
                self._first_in.clear()
            topic = found.channel.topic
            same = hash((topic, message.sequence, message.publish_time, message.data))
            self._topics[topic] += self._first_in.setdefault(same, number) != number
            yield found

    def notes(self) -> tuple[str, ...]:
        """Return what was found, in one line or none."""
        total = self._topics.total()
        topics = ", ".join(topic for topic, number in sorted(self._topics.items()) if number)
        note = f"{total} messages are in several of the recordings, and now several times: {topics}"
        return (note,) if total else ()
