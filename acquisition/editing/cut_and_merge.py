"""Parts of a recording, and several recordings in one.

Messages, metadata and attachments are copied as they are. Both work on sound recordings with an
index and refuse others: what is missing in a damaged one must be told, and `recover` does that.
"""

from __future__ import annotations

import heapq
import json
import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, replace
from itertools import chain, combinations, count
from pathlib import Path

from mcap.records import Channel, Schema

from acquisition.editing.intact_copy import CopyReport, IntactCopy, Progress
from acquisition.editing.intact_recording import Defined, IntactRecording
from acquisition.editing.merge_notes import Repeats, part_notes
from acquisition.editing.recording_copy import RecordingCopy
from acquisition.errors import StreamError
from acquisition.files import refuse_same_file, replacing, written_name
from acquisition.stream.provenance import software_versions
from acquisition.stream.recording_origin import Origin, clock_notes, origin_of

CUT_METADATA_NAME = "terravibe_cut"
MERGE_METADATA_NAME = "terravibe_merge"
_STATIC_TOPIC = "/tf_static"
_NS_PER_S = 1_000_000_000


def cut(
    path: Path,
    output: Path,
    *,
    start_s: float | None = None,
    end_s: float | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
    topics: Collection[str] | None = None,
    progress: Progress = lambda _: None,
) -> CopyReport:
    """Copy what lies between two times; the output appears when it is complete.

    All metadata and attachments are kept, and /tf_static whatever the topics: transforms that
    were published before the cut are repeated at its start, because they hold there.

    Args:
        path: the recording, which is only read.
        output: the new recording.
        start_s: the first moment that counts, seconds after the first message.
        end_s: the first moment that does not count any more, seconds after the first message.
        start_ns: a log time instead of `start_s`.
        end_ns: a log time instead of `end_s`.
        topics: those to copy; all by default.
        progress: called with the part of the work that is done, 0 to 1.

    Raises:
        StreamError: the recording cannot be read or is damaged; the range is empty or given in
            both ways; it has no such topic; or the output cannot be written.
    """
    refuse_same_file(path, output)
    with IntactRecording(path) as recording:
        begin_ns = _bound("start", recording, start_s, start_ns)
        stop_ns = _bound("end", recording, end_s, end_ns)
        begin_ns, stop_ns = _within(recording, begin_ns, stop_ns)
        wanted = _wanted(recording, topics)
        said = recording.messages(start_ns=begin_ns, end_ns=stop_ns, topics=wanted)
        with replacing(output) as temporary, RecordingCopy(temporary, recording.profile) as copy:
            writing = IntactCopy(copy, [recording], wanted)
            writing.keep(recording)
            copy.metadata(CUT_METADATA_NAME, _cut_record(path, begin_ns, stop_ns, topics))
            writing.messages(_earlier_transforms(recording, begin_ns), begin_ns, stop_ns, progress)
            repeated = writing.counts.total()
            writing.messages(said, begin_ns, stop_ns, progress)
            silent = [topic for topic in topics or () if not writing.counts[topic]]
            if len(silent) == len(topics) if topics else writing.counts.total() == repeated:
                raise StreamError(f"{path} has no message of these topics in that range")
        return writing.report(output, tuple(f"{topic}: none in that range" for topic in silent))


def _cut_record(
    path: Path, begin_ns: int, stop_ns: int, topics: Collection[str] | None
) -> dict[str, str]:
    return {
        "source": written_name(path),
        "start_ns": str(begin_ns),
        "end_ns": str(stop_ns),
        "topics": json.dumps(None if topics is None else sorted(topics)),
        "versions": json.dumps(software_versions(), sort_keys=True),
    }


def _bound(
    name: str, recording: IntactRecording, relative_s: float | None, absolute_ns: int | None
) -> int | None:
    if relative_s is None:
        return absolute_ns
    if absolute_ns is not None:
        raise StreamError(f"{name} is given in seconds and in nanoseconds; give one of them")
    if not math.isfinite(relative_s):
        raise StreamError(f"{name} is {relative_s} s; expected a number")
    return recording.statistics.message_start_time + round(relative_s * _NS_PER_S)


def _within(
    recording: IntactRecording, begin_ns: int | None, stop_ns: int | None
) -> tuple[int, int]:
    """Return the range, open ends filled in; refuse one that holds nothing."""
    first_ns = recording.statistics.message_start_time
    last_ns = recording.statistics.message_end_time
    begin_ns = first_ns if begin_ns is None else max(begin_ns, first_ns)
    stop_ns = last_ns + 1 if stop_ns is None else min(stop_ns, last_ns + 1)
    if begin_ns >= stop_ns or not recording.statistics.message_count:
        raise StreamError(
            f"nothing of {recording.path} lies in that range; it reaches from {first_ns} to "
            f"{last_ns} ns ({(last_ns - first_ns) / _NS_PER_S:.3f} s)"
        )
    return begin_ns, stop_ns


def _wanted(recording: IntactRecording, topics: Collection[str] | None) -> set[str] | None:
    if topics is None:
        return None
    known = {channel.topic for channel, _ in recording.channels()}
    if unknown := sorted(set(topics) - known):
        raise StreamError(
            f"{recording.path} has no topic {', '.join(unknown)}; "
            f"it has {', '.join(sorted(known)) or 'none'}"
        )
    return {*topics, _STATIC_TOPIC}


def _earlier_transforms(recording: IntactRecording, begin_ns: int) -> Iterator[Defined]:
    """Give the transforms published before the cut, each once, at its start."""
    if begin_ns <= recording.statistics.message_start_time:
        return
    seen: set[bytes] = set()
    for found in recording.messages(end_ns=begin_ns, topics=[_STATIC_TOPIC]):
        if found.message.data not in seen:
            seen.add(found.message.data)
            yield replace(found, message=replace(found.message, log_time=begin_ns))


def merge(
    paths: Sequence[Path], output: Path, *, progress: Progress = lambda _: None
) -> CopyReport:
    """Copy several recordings into one, by log time; the output appears when it is complete.

    Messages of the same log time keep the order of `paths`. Channels that agree in everything
    become one. A metadata record whose name another recording has used with other content gets
    the file's name behind its own.

    Args:
        paths: two recordings or more, which are only read.
        output: the new recording.
        progress: called with the part of the work that is done, 0 to 1.

    Raises:
        StreamError: one cannot be read or is damaged, two are the same file, a topic has
            different types; or the output cannot be written.
    """
    if len(paths) < 2:
        raise StreamError(f"{len(paths)} recordings to merge; expected two or more")
    for one, other in combinations([*paths, output], 2):
        refuse_same_file(one, other)
    with ExitStack() as stack:
        recordings = [stack.enter_context(IntactRecording(path)) for path in paths]
        _refuse_conflicts(chain(*(recording.channels() for recording in recordings)))
        origins = [origin_of(recording) for recording in recordings]
        profiles = {recording.profile for recording in recordings}
        profile = profiles.pop() if len(profiles) == 1 else ""
        said = heapq.merge(
            *map(_numbered, count(), recordings), key=lambda pair: pair[1].message.log_time
        )
        repeats = Repeats()
        with replacing(output) as temporary, RecordingCopy(temporary, profile) as copy:
            writing = IntactCopy(copy, recordings)
            for recording in recordings:
                writing.keep(recording)
            start_ns = min(origin.start_ns for origin in origins)
            end_ns = max(origin.end_ns for origin in origins)
            writing.messages(repeats.counted(said), start_ns, end_ns, progress)
            _refuse_loss(writing.counts.total(), origins)
            notes = (*clock_notes(origins), *part_notes(recordings), *repeats.notes())
            copy.metadata(MERGE_METADATA_NAME, _merge_record(origins, notes))
        return writing.report(output, notes)


def _numbered(number: int, recording: IntactRecording) -> Iterator[tuple[int, Defined]]:
    return ((number, found) for found in recording.messages())


def _refuse_conflicts(channels: Iterable[tuple[Channel, Schema | None]]) -> None:
    types: dict[str, tuple[str, str, str]] = {}
    for channel, schema in channels:
        name, language = (schema.name, schema.encoding) if schema else ("", "")
        found = (name, language, channel.message_encoding)
        known = types.setdefault(channel.topic, found)
        if known != found:
            raise StreamError(
                f"{channel.topic} is {' '.join(known)} in one recording and {' '.join(found)} in "
                "another; cut that topic out of one of them first"
            )


def _refuse_loss(found: int, origins: Sequence[Origin]) -> None:
    expected = sum(origin.messages for origin in origins)
    if found != expected:
        raise StreamError(
            f"the indexes lead to {found} messages of {expected}; recover the recordings first"
        )


def _merge_record(origins: Sequence[Origin], notes: Sequence[str]) -> dict[str, str]:
    return {
        "inputs": json.dumps([asdict(origin) for origin in origins]),
        "order": "log time",
        "notes": json.dumps(notes),
        "versions": json.dumps(software_versions(), sort_keys=True),
    }
