"""What is intact of a damaged recording, into a new one.

Two passes: the first finds the sound records (`salvage`) and what their channel numbers mean,
which may be told only at the end of the file; the second copies. What is copied, and why:

- A chunk whose checksum is right is copied whole, in its place; one that is damaged is left out
  whole, and so is one that comes a second time. A chunk without a checksum is copied when it
  unpacks to exactly what it announces, unless other chunks of the recording have checksums: then
  the missing one is damage.
- A message outside any chunk has no checksum. It is copied when another record follows exactly
  where it ends, its channel is defined, it decodes if its type is known, and it does not have the
  form of an index or a definition, of which one bit makes a message; it is counted as unproven.
  Where the recording has chunks and the message turned up while searching behind
  damage, it is left out: it may be what a damaged chunk held.
- A message whose topic is told by nothing that has a checksum any more counts as unproven too.
- Metadata has no checksum either: copied when its form is exactly right. Attachments have one.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Message

from acquisition.editing.recording_copy import RecordingCopy
from acquisition.errors import StreamError
from acquisition.files import refuse_same_file, replacing, written_name
from acquisition.messages import codec
from acquisition.recovery.damaged_file import DamagedFile
from acquisition.recovery.record_checks import SoundRecord, may_be_another_kind
from acquisition.recovery.report import RecoveryReport
from acquisition.recovery.salvage import Salvage, Span, first_pass, sound_records
from acquisition.stream.provenance import software_versions

RECOVERY_METADATA_NAME = "terravibe_recovery"
_LISTED_DAMAGES = 1000


def recover(
    path: Path, output: Path, *, progress: Callable[[float], None] = lambda _: None
) -> RecoveryReport:
    """Copy everything that is intact; the output appears when it is complete.

    Memory is bounded by the largest chunk and by the index of the output.

    Args:
        path: any MCAP file, which is only read.
        output: the new recording.
        progress: called with the part of the work that is done, 0 to 1.

    Raises:
        StreamError: the file cannot be read, holds nothing that is intact, or is the output; or
            the output cannot be written.
    """
    refuse_same_file(path, output)
    with DamagedFile(path) as file:
        work_bytes = 2 * max(1, file.size_bytes)
        found = first_pass(file, lambda done: progress(done / work_bytes))
        if not found.spans:
            raise StreamError(f"{path} holds no intact MCAP record; nothing was written")
        with (
            replacing(output) as temporary,
            RecordingCopy(temporary, found.guessed_profile()) as copy,
        ):
            second = _SecondPass(file, found, copy)
            for span in found.spans:
                second.copy_span(span)
                progress(0.5 + span.end / work_bytes)
            copy.metadata(RECOVERY_METADATA_NAME, _provenance(path, file.size_bytes, found))
        return second.report(path, output)


def _provenance(path: Path, size_bytes: int, found: Salvage) -> dict[str, str]:
    damaged = [asdict(damage) for damage in found.damaged[:_LISTED_DAMAGES]]
    return {
        "source": written_name(path),
        "size_bytes": str(size_bytes),
        "damaged": json.dumps(damaged),
        "versions": json.dumps(software_versions(), sort_keys=True),
    }


class _SecondPass:
    def __init__(self, file: DamagedFile, found: Salvage, copy: RecordingCopy) -> None:
        self._file = file
        self._found = found
        self._copy = copy
        self._definitions = found.definitions
        self._numbers: dict[int, int] = {}  # channel number here -> there
        self._messages: Counter[str] = Counter()
        self._unproven: Counter[str] = Counter()
        self._undefined: Counter[int] = Counter()
        self._without_schema: dict[str, None] = {}
        self._attachments = 0
        self._metadata = 0
        self._chunks: set[int] = set()
        for number in sorted(self._definitions.channels):
            self._number(number)

    def copy_span(self, span: Span) -> None:
        """Copy what may be copied of the records of a span."""
        offset = span.start
        try:
            for record in sound_records(self._file, span.start, span.end):
                self._copy_record(record, span)
                offset = record.head.end
        except ValueError as error:
            # It was readable a moment ago: the disk is failing.
            self._found.leave_out(offset, span.end, str(error))

    def _copy_record(self, record: SoundRecord, span: Span) -> None:
        match record.head.opcode:
            case Opcode.CHUNK:
                self._chunk(record)
            case Opcode.MESSAGE:
                self._lone_message(record, span)
            case Opcode.METADATA:
                self._copy.metadata(record.content.name, record.content.metadata)
                self._metadata += 1
            case Opcode.ATTACHMENT:
                self._copy.attachment(record.content)
                self._attachments += 1

    def _chunk(self, record: SoundRecord) -> None:
        vouched = record.proven or self._found.vouched
        if not vouched and self._found.checksummed:
            reason = "chunk without a checksum, which other chunks of the recording have"
            self._found.leave_out(record.head.offset, record.head.end, reason)
            return
        if self._seen_before(record):
            self._found.leave_out(record.head.offset, record.head.end, "a chunk once more")
            return
        for content in record.inside:
            if isinstance(content, Message):
                self._message(content, vouched)
            else:
                self._definitions.override(content)
                self._numbers.clear()

    def _seen_before(self, record: SoundRecord) -> bool:
        """Tell whether the same chunk was copied already: a disk may write a block twice."""
        chunk = record.content
        times = chunk.message_start_time, chunk.message_end_time
        # Numbers that differ between any two chunks which hold messages.
        key = hash((*times, chunk.uncompressed_crc, chunk.uncompressed_size))
        known = key in self._chunks
        self._chunks.add(key)
        return known and record.proven

    def _lone_message(self, record: SoundRecord, span: Span) -> None:
        reason = ""
        if not self._found.vouched:
            if self._found.chunked and not span.anchored:
                reason = "message found behind damage; it may be what a damaged chunk held"
            elif may_be_another_kind(record.body, chunked=self._found.chunked):
                reason = "message that has the form of another record"
            elif not self._decodes(record.content):
                reason = "message that does not decode"
        if reason:
            self._found.leave_out(record.head.offset, record.head.end, reason)
        else:
            self._message(record.content, self._found.vouched)

    def _decodes(self, message: Message) -> bool:
        channel = self._definitions.channels.get(message.channel_id)
        schema = self._definitions.schemas.get(channel.schema_id) if channel else None
        row = codec.find(channel.topic, schema.name) if channel and schema else None
        if row is None or channel is None or channel.message_encoding != "cdr":
            return True
        try:
            codec.decode(row, message.data, log_time_ns=message.log_time, sequence=message.sequence)
        except StreamError:
            return False
        return True

    def _message(self, message: Message, vouched: bool) -> None:
        number = self._numbers.get(message.channel_id)
        if number is None:
            number = self._number(message.channel_id)
        if number is None:
            self._undefined[message.channel_id] += 1
            return
        self._copy.message(number, message)
        topic = self._definitions.channels[message.channel_id].topic
        self._messages[topic] += 1
        if not (vouched and self._definitions.proves(message.channel_id)):
            self._unproven[topic] += 1

    def _number(self, channel_id: int) -> int | None:
        """Define a channel in the copy; None when nothing defines it here."""
        channel = self._definitions.channels.get(channel_id)
        if channel is None:
            return None
        schema = self._definitions.schemas.get(channel.schema_id)
        if schema is None and channel.schema_id:
            self._without_schema[channel.topic] = None
        self._numbers[channel_id] = self._copy.define(channel, schema)
        return self._numbers[channel_id]

    def report(self, path: Path, output: Path) -> RecoveryReport:
        """Return what was done."""
        found = self._found
        return RecoveryReport(
            source=str(path),
            output=str(output),
            size_bytes=self._file.size_bytes,
            messages=dict(sorted(self._messages.items())),
            expected=self._expected(),
            unproven=dict(sorted(self._unproven.items())),
            undefined=dict(sorted(self._undefined.items())),
            without_schema=tuple(self._without_schema),
            attachments=self._attachments,
            metadata=self._metadata,
            damaged=tuple(sorted(found.damaged, key=lambda damage: damage.offset)),
            lost_chunks=tuple(found.lost_chunks),
            doubted=found.doubted,
            restored=found.restored,
            complete=found.complete,
        )

    def _expected(self) -> dict[str, int] | None:
        if self._found.expected is None:
            return None
        expected: Counter[str] = Counter()
        for channel_id, number in self._found.expected.items():
            channel = self._definitions.channels.get(channel_id)
            expected[channel.topic if channel else f"(channel {channel_id})"] += number
        return dict(sorted(expected.items()))
