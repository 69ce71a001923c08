"""One pass over a recording that keeps no content: times, numbers and sizes for each topic."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from acquisition.errors import StreamError
from acquisition.health.diagnostics import Diagnostics
from acquisition.messages import codec
from acquisition.recovery.container import Container, RecordedMessage
from acquisition.stream.byte_source import FinishedFile
from acquisition.stream.read_report import Damage
from drivers.faults import NO_FAULTS, Faults


@dataclass(slots=True)
class TopicLog:
    """What was seen on one topic, in file order.

    Attributes:
        ros_type: name of its schema.
        log_times_ns: log time of each message.
        sequences: sequence number of each message.
        size_bytes: sum of the messages before compression.
        unprotected: messages that no checksum vouches for.
        unreadable: messages that do not decode, though they should.
        first_error: why the first of them does not.
        health: the last health record; None where there is none.
    """

    ros_type: str
    log_times_ns: array[int] = field(default_factory=lambda: array("Q"))
    sequences: array[int] = field(default_factory=lambda: array("I"))
    size_bytes: int = 0
    unprotected: int = 0
    unreadable: int = 0
    first_error: str = ""
    health: Diagnostics | None = None

    def add(self, message: RecordedMessage) -> None:
        """Take a message into account."""
        self.log_times_ns.append(message.log_time_ns)
        self.sequences.append(message.sequence)
        self.size_bytes += len(message.data)
        self.unprotected += not message.protected
        row = codec.find(message.topic, message.ros_type)
        if row is None or message.encoding != "cdr":
            return
        try:
            found = codec.decode(
                row, message.data, log_time_ns=message.log_time_ns, sequence=message.sequence
            )
        except StreamError as error:
            self.unreadable += 1
            self.first_error = self.first_error or str(error)
        else:
            if isinstance(found, Diagnostics):
                self.health = found


@dataclass(frozen=True, slots=True)
class Survey:
    """What is in a recording.

    Attributes:
        path: the file.
        size_bytes: how much of it was read, which is all unless reading broke off.
        topics: what was seen on each topic.
        metadata: the metadata records, by name.
        damaged: parts that cannot be used.
        truncated_bytes: bytes behind the last complete record.
        complete: the proper end is there.
    """

    path: Path
    size_bytes: int
    topics: Mapping[str, TopicLog]
    metadata: Mapping[str, Mapping[str, str]]
    damaged: tuple[Damage, ...]
    truncated_bytes: int
    complete: bool

    def faults(self) -> dict[str, Faults]:
        """Return what each source's driver had counted at the end, as the health records say."""
        records = [log.health for log in self.topics.values() if log.health is not None]
        return {
            status.name: faults
            for record in records
            for status in record.statuses
            if (faults := status.faults()) != NO_FAULTS
        }


def survey(path: Path) -> Survey:
    """Read the whole recording.

    Raises:
        StreamError: the file cannot be read or is no recording.
    """
    topics: dict[str, TopicLog] = {}
    with FinishedFile(path) as file:
        container = Container(file)
        for message in container:
            topics.setdefault(message.topic, TopicLog(message.ros_type)).add(message)
    return Survey(
        path=path,
        size_bytes=container.bytes_read + container.truncated_bytes,
        topics=dict(sorted(topics.items())),
        metadata=container.metadata,
        damaged=tuple(container.damaged),
        truncated_bytes=container.truncated_bytes,
        complete=container.complete,
    )
