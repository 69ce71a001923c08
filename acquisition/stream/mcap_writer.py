"""MCAP, written for a recorder that runs for days beside everything else on a small computer.

`mcap.writer.Writer` spends 5 us on each message, and keeps an object with a dictionary for each
chunk until the file ends: at 20 chunks a second, 1.7 MB of memory per minute. This writer gives
the same bytes for the same calls (a test compares them); a message costs it 1 us, and of a chunk
it keeps what the summary section will hold, compressed. All but chunks with their messages
and index is written by mcap's own records.

Format: https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from acquisition.messages.cdr_layout import Parts
from acquisition.stream.checksum import crc32
from acquisition.stream.chunk_builder import ChunkBuilder
from acquisition.stream.framing import MAGIC
from acquisition.stream.index_store import IndexStore
from acquisition.stream.output import StreamOutput

_SIGNED_FOOTER = struct.Struct("<BQQQ")  # what of the footer the summary's checksum covers
_FOOTER_BYTES = 20


class McapWriter:
    """Writes chunks under zstd with checksums and a full index; attachments it does not know."""

    def __init__(
        self, output: StreamOutput, chunk_size_bytes: int, index: IndexStore | None = None
    ) -> None:
        """Write nothing yet.

        Args:
            output: where the bytes go.
            chunk_size_bytes: a chunk that is larger, before compression, is closed.
            index: what keeps the chunk index until the end; of one writer at a time.
        """
        self._output = output
        self._chunk_size_bytes = chunk_size_bytes
        self._chunk = ChunkBuilder()
        self._chunk_indexes = index or IndexStore()
        self._chunk_indexes.clear()
        self._metadata_indexes = RecordBuilder()
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._counts: Counter[int] = Counter()
        self._times_ns: tuple[int, int] | None = None
        self._chunks = self._metadata = 0

    def start(self, profile: str, library: str) -> None:
        """Write magic and header; StreamError, as from all that follows, if the output refuses."""
        self._output.write(MAGIC)
        self._output.write(_bytes_of(Header(profile, library)))

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Define a schema in the chunk in progress; return its number."""
        schema = Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name)
        self._schemas.append(schema)
        self._define(schema)
        return schema.id

    def register_channel(self, topic: str, encoding: str, schema_id: int) -> int:
        """Define a channel in the chunk in progress; return its number."""
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding=encoding,
            metadata={},
            schema_id=schema_id,
        )
        self._channels.append(channel)
        self._define(channel)
        return channel.id

    def add_metadata(self, name: str, record: Mapping[str, str]) -> None:
        """Write a metadata record; the chunk in progress stays open."""
        offset, data = self._output.tell(), _bytes_of(Metadata(name, dict(record)))
        self._output.write(data)
        MetadataIndex(offset, len(data), name).write(self._metadata_indexes)
        self._metadata += 1

    def add_messages(
        self,
        channel_ids: Sequence[int],
        messages: Sequence[Parts | None],
        log_time_ns: int,
        publish_time_ns: int,
        sequence: int,
    ) -> int:
        """Add what one sample is written as to the chunk in progress; return the size of its data.

        Args:
            channel_ids: what `register_channel` returned, for each message.
            messages: the data of each, kept as it is until the chunk is closed; None leaves it out.
            log_time_ns: 0 to 2^64-1, as the publish time.
            publish_time_ns: when it was sent.
            sequence: 0 to 2^32-1.
        """
        chunk = self._chunk
        size_bytes = chunk.add(channel_ids, messages, log_time_ns, publish_time_ns, sequence)
        if chunk.size_bytes > self._chunk_size_bytes:
            self._close_chunk()
        return size_bytes

    def _define(self, definition: Schema | Channel) -> None:
        self._chunk.define(definition)
        if self._chunk.size_bytes > self._chunk_size_bytes:
            self._close_chunk()

    def _close_chunk(self) -> None:
        chunk = self._chunk.finish(self._output.tell())
        if chunk is None:
            return
        self._chunks += 1
        self._counts.update(chunk.counts)
        first_ns, last_ns = self._times_ns or (chunk.first_ns, 0)
        self._times_ns = min(first_ns, chunk.first_ns), max(last_ns, chunk.last_ns)
        self._output.write(chunk.record)
        self._output.write(chunk.index_record)
        self._chunk_indexes.add(chunk.summary)

    def flush(self) -> None:
        """Close the chunk in progress and hand everything to the operating system."""
        self._close_chunk()
        self._output.flush()

    def finish(self) -> None:
        """Close the chunk in progress; write the summary section, the footer and the magic."""
        self._close_chunk()
        self._output.write(_bytes_of(DataEnd(0)))  # the output fills in the checksum
        start, crc, offsets = self._output.tell(), 0, b""
        for opcode, group in self._summary():
            group_start = self._output.tell()
            for records in group:
                crc = crc32(records, crc)
                self._output.write(records)
            group_bytes = self._output.tell() - group_start
            offsets += _bytes_of(SummaryOffset(opcode, group_start, group_bytes))
        offsets_start = self._output.tell()
        signed = _SIGNED_FOOTER.pack(Opcode.FOOTER, _FOOTER_BYTES, start, offsets_start)
        self._output.write(offsets)
        self._output.write(_bytes_of(Footer(start, offsets_start, crc32(offsets + signed, crc))))
        self._output.write(MAGIC)

    def _summary(self) -> Iterator[tuple[Opcode, Iterable[bytes]]]:
        """Give the groups of the summary section, each in pieces of whole records."""
        yield Opcode.SCHEMA, [_bytes_of(*self._schemas)]
        yield Opcode.CHANNEL, [_bytes_of(*self._channels)]
        yield Opcode.STATISTICS, [_bytes_of(self._statistics())]
        yield Opcode.CHUNK_INDEX, self._chunk_indexes.take()
        yield Opcode.ATTACHMENT_INDEX, []
        yield Opcode.METADATA_INDEX, [self._metadata_indexes.end()]

    def _statistics(self) -> Statistics:
        first_ns, last_ns = self._times_ns or (0, 0)
        return Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=self._chunks,
            message_count=self._counts.total(),
            message_end_time=last_ns,
            message_start_time=first_ns,
            metadata_count=self._metadata,
            schema_count=len(self._schemas),
        )


def _bytes_of(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()
    return data
