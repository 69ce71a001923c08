"""Messages of other recordings, as they are, into a new one with an index and checksums."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Self, cast

from mcap.data_stream import RecordBuilder
from mcap.records import Attachment, Channel, Message, Schema
from mcap.writer import Writer

from acquisition.stream.output import StreamOutput
from acquisition.stream.provenance import software_versions


class RecordingCopy:
    """Writes a recording of encoded messages: zstd chunks, a checksum on everything, in order.

    What was flushed as many small chunks for the sake of a follower becomes few large ones.
    Leaving the `with` block by an error closes the file without an end.
    """

    def __init__(self, path: Path, profile: str) -> None:
        """Create or replace the file.

        Args:
            path: the file.
            profile: "ros2", or whatever the recordings that are copied say.

        Raises:
            StreamError: it cannot be written.
        """
        self._output = StreamOutput(path)
        # Of a file, the Writer uses only what StreamOutput has.
        self._writer = Writer(cast(IO[bytes], self._output))
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._channels: dict[object, int] = {}
        try:
            self._writer.start(profile, f"terravibe {software_versions()['terravibe']}")
        except BaseException:
            self._output.close()
            raise

    def define(self, channel: Channel, schema: Schema | None) -> int:
        """Return the number under which the channel is written; the same for the same channel.

        A new one is written outside the chunks too, where it survives the loss of the first.

        Args:
            channel: topic, encoding and metadata; its own number tells apart publishers that
                agree in all of these.
            schema: of its messages; None where it has none.

        Raises:
            StreamError: the output refused it.
        """
        schema_id = self._define_schema(schema) if schema else 0
        topic, encoding = channel.topic, channel.message_encoding
        key = (channel.id, topic, encoding, tuple(sorted(channel.metadata.items())), schema_id)
        if key not in self._channels:
            number = self._writer.register_channel(topic, encoding, schema_id, channel.metadata)
            self._channels[key] = number
            self._write(Channel(number, topic, encoding, channel.metadata, schema_id))
        return self._channels[key]

    def _define_schema(self, schema: Schema) -> int:
        key = (schema.name, schema.encoding, schema.data)
        if key not in self._schemas:
            number = self._writer.register_schema(*key)
            self._schemas[key] = number
            self._write(Schema(number, schema.data, schema.encoding, schema.name))
        return self._schemas[key]

    def _write(self, record: Schema | Channel) -> None:
        builder = RecordBuilder()
        record.write(builder)
        self._output.write(builder.end())

    def message(self, number: int, message: Message) -> None:
        """Append a message of the channel that `define` gave that number.

        Raises:
            StreamError: the output refused it.
        """
        self._writer.add_message(
            number, message.log_time, message.data, message.publish_time, message.sequence
        )

    def metadata(self, name: str, record: Mapping[str, str]) -> None:
        """Append a metadata record.

        Raises:
            StreamError: the output refused it.
        """
        self._writer.flush()  # it stays behind the messages that came before it
        self._writer.add_metadata(name, dict(record))

    def attachment(self, attachment: Attachment) -> None:
        """Append an attachment.

        Raises:
            StreamError: the output refused it.
        """
        self._writer.flush()
        self._writer.add_attachment(
            create_time=attachment.create_time,
            log_time=attachment.log_time,
            name=attachment.name,
            media_type=attachment.media_type,
            data=attachment.data,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            if exc_type is None:
                self._writer.finish()
        finally:
            self._output.close()
