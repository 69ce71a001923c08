"""One reader for every stream: a finished file, a growing one, a pipe; same bytes, same result."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from acquisition.clocks.clock_sample import ClockSample
from acquisition.errors import StreamError
from acquisition.health.diagnostics import Diagnostics
from acquisition.messages import codec
from acquisition.messages.codec import Recordable
from acquisition.messages.companions import Companion, Companions
from acquisition.messages.depth import CameraInfo, DepthImage
from acquisition.messages.depth_pairing import DepthPairing
from acquisition.messages.frames import StaticTransforms
from acquisition.recovery.container import Container, RecordedMessage
from acquisition.stream.byte_source import ByteSource
from acquisition.stream.framing import MAX_RECORD_BYTES
from acquisition.stream.read_report import ReadReport
from acquisition.stream.reorder import ReorderBuffer
from drivers.samples import Sample

REORDER_WINDOW_NS = 500_000_000
_NO_TOPICS: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class StreamMessage:
    """One thing that the stream says.

    Attributes:
        log_time_ns: the time by which the stream is ordered.
        topic: where it was published, by the names of `codec.MESSAGE_TYPES`.
        sample: what it says, put together from all of its messages.
        sequence: the number its source gave it.
    """

    log_time_ns: int
    topic: str
    sample: Recordable
    sequence: int


@dataclass(frozen=True, slots=True)
class _Waiting:
    """What waits in the reorder buffer; a camera and a companion come to it when it leaves."""

    log_time_ns: int
    topic: str
    content: DepthImage | Sample | ClockSample | Diagnostics
    sequence: int


class StreamReader:
    """Iterate it, once, to get every message in order of log time.

    Static transforms hold for all times and are handed on as soon as they are read; everything
    else passes a `ReorderBuffer`. Truncated and damaged parts are left out and reported; a chunk
    is handed on whole or not at all. The result is a function of the bytes: how they arrive, and
    how the writer cut the messages into chunks, makes no difference.
    """

    def __init__(
        self,
        source: ByteSource,
        *,
        reorder_window_ns: int = REORDER_WINDOW_NS,
        topics: Mapping[str, str] = _NO_TOPICS,
        max_record_bytes: int = MAX_RECORD_BYTES,
    ) -> None:
        """Read nothing yet.

        Args:
            source: the bytes; closing it is left to its owner.
            reorder_window_ns: how much older than its predecessors a message may be.
            topics: topic of the recording -> topic of `codec.MESSAGE_TYPES` as which to read
                it; the others keep their names.
            max_record_bytes: a longer record is taken for nonsense.

        Raises:
            StreamError: the reorder window is negative.
        """
        if reorder_window_ns < 0:
            raise StreamError(
                f"the reorder window is {reorder_window_ns} ns; expected 0 or more, such as "
                f"{REORDER_WINDOW_NS}"
            )
        self._name = source.name
        self._topics = topics
        self._container = Container(source, max_record_bytes)
        self._reorder: ReorderBuffer[_Waiting] = ReorderBuffer(reorder_window_ns)
        self._pairing = DepthPairing()
        self._companions = Companions()
        self._counts: Counter[str] = Counter()
        self._skipped: Counter[str] = Counter()
        self._late = 0
        self._unprotected = 0

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """The metadata records seen so far, by name."""
        return self._container.metadata

    @property
    def report(self) -> ReadReport:
        """What was read so far."""
        return ReadReport(
            name=self._name,
            bytes_read=self._container.bytes_read,
            messages=dict(self._counts),
            skipped=dict(self._skipped),
            late_messages=self._late,
            unprotected_messages=self._unprotected,
            truncated_bytes=self._container.truncated_bytes,
            damaged=tuple(self._container.damaged),
            complete=self._container.complete,
        )

    def __iter__(self) -> Iterator[StreamMessage]:
        """Give the messages.

        Raises:
            StreamError: no MCAP stream; the source failed; or a message cannot be understood,
                naming its topic and time.
        """
        for recorded in self._container:
            self._unprotected += not recorded.protected
            yield from self._take(recorded)
            yield from map(self._hand_on, self._reorder.ready())
        yield from map(self._hand_on, self._reorder.rest())

    def _take(self, recorded: RecordedMessage) -> Iterator[StreamMessage]:
        """Put a message where it waits; hand it on if it need not wait."""
        row = self._row(recorded)
        if row is None:
            self._skipped[recorded.topic] += 1
            return
        self._counts[row.topic] += 1
        log_time_ns, sequence = recorded.log_time_ns, recorded.sequence
        content = codec.decode(row, recorded.data, log_time_ns=log_time_ns, sequence=sequence)
        if isinstance(content, CameraInfo):
            self._pairing.add(content)
        elif isinstance(content, Companion):
            self._companions.add(content)
        elif isinstance(content, StaticTransforms):
            yield StreamMessage(log_time_ns, row.topic, content, sequence)
        else:
            waiting = _Waiting(log_time_ns, row.topic, content, sequence)
            self._late += not self._reorder.push(log_time_ns, waiting)

    def _row(self, recorded: RecordedMessage) -> codec.MessageType | None:
        if recorded.encoding != "cdr":
            return None
        topic = self._topics.get(recorded.topic, recorded.topic)
        return codec.find(topic, recorded.ros_type)

    def _hand_on(self, waiting: _Waiting) -> StreamMessage:
        content = waiting.content
        sample = self._pairing.frame(content) if isinstance(content, DepthImage) else content
        if further := self._companions.take(type(sample), sample.t_ns):
            sample = replace(sample, **further)
        return StreamMessage(waiting.log_time_ns, waiting.topic, sample, waiting.sequence)
