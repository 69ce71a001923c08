"""Samples into one MCAP stream that a crash, a bad disk and a slow reader can do little to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Schema

from acquisition.clocks.clock_sample import ClockSample
from acquisition.closing import ClosedOnExit
from acquisition.errors import StreamError
from acquisition.messages import codec
from acquisition.messages.codec import DepthFormat, MessageType, Recordable
from acquisition.messages.depth_rvl import prepare_rvl
from acquisition.messages.frames import StaticTransform, StaticTransforms
from acquisition.stream.index_store import IndexStore
from acquisition.stream.mcap_writer import McapWriter
from acquisition.stream.output import StreamOutput
from acquisition.stream.provenance import METADATA_NAME, provenance, software_versions
from drivers.samples import Sample
from drivers.source import SourceInfo

CHUNK_SIZE_BYTES = 2 << 20
FLUSH_INTERVAL_NS = 50_000_000
# What the MCAP message record has room for.
_MAX_LOG_TIME_NS = 2**64 - 1
_MAX_SEQUENCE = 2**32 - 1


class _Route(NamedTuple):
    """Which messages stand for a sample of one type, and the channel of each."""

    rows: Sequence[MessageType]
    channel_ids: Sequence[int]


class StreamWriter(ClosedOnExit):
    """Writes a recording: profile "ros2", CDR messages, zstd chunks, a checksum on everything.

    The order in the file is: provenance; every schema and channel that the sources may need,
    outside any chunk, so that they survive the loss of the first one (which repeats them, as
    does the summary); /tf_static at the time of the first sample; the samples as they come.

    A chunk is closed when it is full or when the stream's own time has advanced by the flush
    interval, so that a follower sees it; there is no wall clock in here. One thread at a time.
    """

    def __init__(
        self,
        output: Path | BinaryIO,
        *,
        sources: Sequence[SourceInfo],
        static_transforms: Sequence[StaticTransform],
        settings: Mapping[str, object],
        extra_types: Sequence[type[Recordable]] = (),
        depth_format: DepthFormat = "raw",
        flush_interval_ns: int = FLUSH_INTERVAL_NS,
        chunk_size_bytes: int = CHUNK_SIZE_BYTES,
        index: IndexStore | None = None,
    ) -> None:
        """Start the stream; its head is with the operating system when this returns.

        Args:
            output: a file to create or replace, or an open stream, which may be a pipe.
            sources: what will be written; a sample of another type is refused.
            static_transforms: where the frames sit, for the whole recording.
            settings: the resolved configuration, as JSON values.
            extra_types: what the writing program itself has to say, beside its sources.
            depth_format: how depth frames are written; readers make no difference.
            flush_interval_ns: stream time after which an open chunk is closed.
            chunk_size_bytes: size before compression at which a chunk is closed.
            index: memory for the chunk index, used again by the next writer; None for some of
                its own.

        Raises:
            StreamError: the output cannot be written, the settings are not JSON, or two sources
                produce the same type, which one stream cannot tell apart.
        """
        self._sources = list(sources)
        self._settings = settings
        types = {ClockSample, *extra_types, *_sample_types(sources)}
        self._left_out = codec.left_out_by(depth_format)
        if depth_format == "rvl":
            prepare_rvl()
        record = provenance(sources, settings)
        self._transforms = tuple(static_transforms)
        self._flush_interval_ns = flush_interval_ns
        self._flushed_at_ns: int | None = None
        self._closed = False
        self._output = StreamOutput(output)
        self._writer = McapWriter(self._output, chunk_size_bytes, index)
        try:
            self._writer.start("ros2", f"terravibe {software_versions()['terravibe']}")
            self._writer.add_metadata(METADATA_NAME, record)
            self._channels: dict[str, int] = {}
            self._schemas: dict[str, int] = {}
            self._define_channels([StaticTransforms, *types])
            self._routes = {kind: self._route(kind) for kind in types}
            self._output.flush()
        except BaseException:
            self._output.close()
            raise

    @property
    def bytes_written(self) -> int:
        """Length of the stream so far, the chunk in progress not included."""
        return self._output.tell()

    @property
    def failed(self) -> bool:
        """Whether the output refused something, so that nothing more can be written."""
        return self._output.failed

    def _define_channels(self, types: Sequence[type[Recordable]]) -> None:
        """Register the channels of these types and write their definitions at top level."""
        builder = RecordBuilder()
        for row in codec.types_of(types):
            if row.topic in self._left_out:
                continue
            codec.prepare(row)
            if row.ros_type not in self._schemas:
                text = codec.schema_text(row.ros_type).encode()
                schema_id = self._writer.register_schema(row.ros_type, "ros2msg", text)
                self._schemas[row.ros_type] = schema_id
                Schema(schema_id, text, "ros2msg", row.ros_type).write(builder)
            schema_id = self._schemas[row.ros_type]
            channel_id = self._writer.register_channel(row.topic, "cdr", schema_id)
            self._channels[row.topic] = channel_id
            Channel(channel_id, row.topic, "cdr", {}, schema_id).write(builder)
        self._output.write(builder.end())

    def _route(self, kind: type[Recordable]) -> _Route:
        """Return how such samples are written, whose channels are defined."""
        rows = [row for row in codec.rows_of(kind) if row.topic not in self._left_out]
        return _Route(rows, [self._channels[row.topic] for row in rows])

    def add_source(self, info: SourceInfo) -> None:
        """Announce a source that turned up late, or what answers now under a source's name.

        The provenance is written again, with it.

        Raises:
            StreamError: closed, another source produces the same type, or the output refused.
        """
        self._require_open()
        sources = with_source(self._sources, info)
        _sample_types(sources)
        self._writer.add_metadata(METADATA_NAME, provenance(sources, self._settings))
        new = [kind for kind in info.produces if kind not in self._routes]
        self._define_channels(new)
        self._sources = sources
        self._routes |= {kind: self._route(kind) for kind in new}

    def add_metadata(self, name: str, record: Mapping[str, str]) -> None:
        """Write a metadata record; a reader keeps the last one of each name.

        Raises:
            StreamError: closed, or the output refused it.
        """
        self._require_open()
        self._writer.add_metadata(name, record)

    def _require_open(self) -> None:
        if self._closed or self._output.failed:
            raise StreamError(f"cannot write {self._output.name}: it is closed or has failed")

    def write(
        self,
        sample: Recordable,
        log_time_ns: int | None = None,
        t_ns: int | None = None,
        sequence: int | None = None,
    ) -> int:
        """Append a sample; return its size before compression, bytes.

        Args:
            sample: of a type that one of the sources produces, of the extra types, or a clock.
            log_time_ns: the time by which the stream is ordered and flushed; without it, the
                sample's own time.
            t_ns: its time in the stream, where that is not its own.
            sequence: its number in the stream, likewise.

        Raises:
            StreamError: closed, not announced, not expressible as a message, or the output
                refused it (disk full).
        """
        route = self._routes.get(type(sample))
        if route is None or self._closed or self._output.failed:
            self._require_open()
            raise StreamError(f"no source of this recording produces {type(sample).__name__}")
        if t_ns is None:
            t_ns = sample.t_ns
        if log_time_ns is None:
            log_time_ns = t_ns
        if not 0 <= log_time_ns <= _MAX_LOG_TIME_NS:
            raise StreamError(f"log time {log_time_ns} ns is outside 0 to 2^64-1")
        if sequence is None or not 0 <= sequence <= _MAX_SEQUENCE:
            sequence = codec.checked_sequence(sample, sequence)
        encoded = codec.encode_rows(sample, route.rows, t_ns, sequence)
        if self._flushed_at_ns is None:
            self._write_transforms(log_time_ns)
            self._flushed_at_ns = log_time_ns
        size_bytes = self._writer.add_messages(
            route.channel_ids, encoded, log_time_ns, t_ns, sequence
        )
        if log_time_ns - self._flushed_at_ns >= self._flush_interval_ns:
            self.flush()
            self._flushed_at_ns = log_time_ns
        return size_bytes

    def _write_transforms(self, log_time_ns: int) -> None:
        if self._transforms:
            message = StaticTransforms(log_time_ns, self._transforms)
            route = self._route(StaticTransforms)
            encoded = codec.encode_rows(message, route.rows, log_time_ns, 0)
            self._writer.add_messages(route.channel_ids, encoded, log_time_ns, log_time_ns, 0)

    def flush(self) -> None:
        """Close the chunk in progress and hand it to the operating system.

        Raises:
            StreamError: the output refused it.
        """
        self._writer.flush()

    def close(self) -> None:
        """Write index and footer and close the file; harmless when closed.

        After a failed write the file ends behind the last record that arrived whole.

        Raises:
            StreamError: the output refused the last bytes.
        """
        if self._closed:
            return
        self._closed = True
        try:
            if not self._output.failed:
                self._writer.finish()
                self._output.flush()
        finally:
            self._output.close()


def with_source(sources: Sequence[SourceInfo], info: SourceInfo) -> list[SourceInfo]:
    """Return the sources with this one in place of the one that has its name, or at the end."""
    return [source for source in sources if source.name != info.name] + [info]


def _sample_types(sources: Sequence[SourceInfo]) -> list[type[Sample]]:
    owners: dict[type[Sample], str] = {}
    for info in sources:
        for kind in info.produces:
            if kind in owners:
                raise StreamError(
                    f"{owners[kind]} and {info.name} both produce {kind.__name__}; "
                    "record them into separate files"
                )
            owners[kind] = info.name
    return list(owners)
