"""What an MCAP container holds, damage set aside: messages in file order, still encoded."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd, Footer, Message, Metadata, Schema

from acquisition.recovery.record_checks import may_be_another_kind
from acquisition.stream.byte_source import ByteSource
from acquisition.stream.checksum import crc32
from acquisition.stream.chunks import Content, open_chunk, parse, parse_chunk, parse_message
from acquisition.stream.framing import HEAD, MAX_RECORD_BYTES, RawRecord, RecordFramer
from acquisition.stream.read_report import Damage

_FOOTER_CRC_BYTES = 4  # the checksum cannot vouch for itself


@dataclass(frozen=True, slots=True)
class RecordedMessage:
    """A message as it was recorded.

    Attributes:
        topic: the recording's name for where it was published.
        ros_type: name of its schema; "" where the recording does not define it.
        encoding: how `data` is encoded, "cdr" for ROS 2.
        log_time_ns: the time by which the recording is ordered.
        sequence: the number its publisher gave it.
        data: its bytes.
        protected: a checksum vouches for it.
    """

    topic: str
    ros_type: str
    encoding: str
    log_time_ns: int
    sequence: int
    data: bytes
    protected: bool


class Container:
    """Iterate it, once, to get every message that can be trusted, in file order.

    A damaged chunk is left out whole; reading goes on behind it. Where the next record cannot be
    found, reading ends.

    Attributes:
        metadata: the metadata records seen so far, by name.
        damaged: what was left out so far.
        truncated_bytes: bytes behind the last complete record, known at the end.
    """

    def __init__(self, source: ByteSource, max_record_bytes: int = MAX_RECORD_BYTES) -> None:
        self.metadata: dict[str, dict[str, str]] = {}
        self.damaged: list[Damage] = []
        self.truncated_bytes = 0
        self._framer = RecordFramer(source, max_record_bytes)
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._in_summary = False
        self._chunked = False

    @property
    def bytes_read(self) -> int:
        """Length of all complete records so far."""
        return self._framer.offset

    @property
    def complete(self) -> bool:
        """Whether the proper end was reached."""
        return self._framer.ended_well

    def __iter__(self) -> Iterator[RecordedMessage]:
        """Give the messages.

        Raises:
            StreamError: no MCAP stream, or the source failed.
        """
        for record in self._framer.records():
            yield from self._messages_in(record)
        if self._framer.ended_well:
            return
        self.truncated_bytes = self._framer.left_over_bytes()
        if self._framer.lost:
            self._damage(self._framer.offset, self.truncated_bytes, self._framer.lost)

    def _damage(self, offset: int, length_bytes: int, reason: str) -> None:
        self.damaged.append(Damage(offset, length_bytes, reason))

    def _messages_in(self, record: RawRecord) -> list[RecordedMessage]:
        """Return the messages of a top-level record, and note whatever else it says."""
        if record.opcode == Opcode.CHUNK:
            return self._chunk(record)
        if self._in_summary and record.opcode != Opcode.FOOTER:
            return []  # it repeats what was read, for readers that jump
        try:
            return self._outside_chunks(record)
        except ValueError as error:
            self._damage(record.offset, record.length_bytes, str(error))
            return []

    def _outside_chunks(self, record: RawRecord) -> list[RecordedMessage]:
        match record.opcode:
            case Opcode.MESSAGE:
                return [self._lone_message(record)]
            case Opcode.SCHEMA:
                schema = parse(Schema.read, record.body)
                self._schemas.setdefault(schema.id, schema)
            case Opcode.CHANNEL:
                channel = parse(Channel.read, record.body)
                self._channels.setdefault(channel.id, channel)
            case Opcode.METADATA:
                metadata = parse(Metadata.read, record.body)
                self.metadata[metadata.name] = metadata.metadata
            case Opcode.DATA_END:
                self._in_summary = True
                self._check_data_section(record)
            case Opcode.FOOTER:
                self._check_summary(record)
        return []

    def _lone_message(self, record: RawRecord) -> RecordedMessage:
        """Return a message outside chunks; one wrong bit makes such a one of other records."""
        if may_be_another_kind(record.body, chunked=self._chunked):
            raise ValueError("message that has the form of another record")
        return self._recorded(parse_message(record.body), protected=False)

    def _chunk(self, record: RawRecord) -> list[RecordedMessage]:
        start_ns = end_ns = None
        self._chunked = True
        try:
            chunk = parse_chunk(record.body)
            start_ns, end_ns = chunk.message_start_time, chunk.message_end_time
            contents = open_chunk(chunk)
        except ValueError as error:
            damage = Damage(record.offset, record.length_bytes, str(error), start_ns, end_ns)
            self.damaged.append(damage)
            return []
        self._define(contents)
        protected = chunk.uncompressed_crc != 0
        return [self._recorded(c, protected=protected) for c in contents if isinstance(c, Message)]

    def _define(self, contents: list[Content]) -> None:
        """Keep a chunk's schemas and channels: under its checksum they overrule those outside."""
        for content in contents:
            if isinstance(content, Schema):
                self._schemas[content.id] = content
            elif isinstance(content, Channel):
                self._channels[content.id] = content

    def _recorded(self, message: Message, *, protected: bool) -> RecordedMessage:
        channel = self._channels.get(message.channel_id)
        schema = self._schemas.get(channel.schema_id) if channel else None
        return RecordedMessage(
            topic=channel.topic if channel else f"(channel {message.channel_id}, not defined)",
            ros_type=schema.name if schema else "",
            encoding=channel.message_encoding if channel else "",
            log_time_ns=message.log_time,
            sequence=message.sequence,
            data=message.data,
            protected=protected,
        )

    def _check_data_section(self, record: RawRecord) -> None:
        expected = parse(DataEnd.read, record.body).data_section_crc
        # Damage that was reported already explains it; otherwise it lies outside the chunks.
        if expected not in (0, record.crc_before) and not self.damaged:
            self._damage(0, record.offset, "checksum of the data section differs")

    def _check_summary(self, record: RawRecord) -> None:
        expected = parse(Footer.read, record.body).summary_crc
        signed = HEAD.pack(record.opcode, len(record.body)) + record.body[:-_FOOTER_CRC_BYTES]
        if expected not in (0, crc32(signed, record.crc_before)):
            self._damage(record.offset, record.length_bytes, "checksum of the summary differs")
