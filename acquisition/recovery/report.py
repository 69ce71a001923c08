"""What was saved of a damaged recording, and what was not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace

from acquisition.stream.read_report import Damage


@dataclass(frozen=True, slots=True)
class RecoveryReport:
    """The result of `recover`.

    Attributes:
        source: the damaged recording.
        output: where the rest of it is now.
        size_bytes: length of the damaged recording.
        messages: messages saved for each topic, those without a checksum included.
        expected: messages for each topic by the recording's own summary; None where that is
            lost too.
        unproven: messages saved for each topic of which no checksum vouches for the content, or
            for the topic's name and type: they have the right form, and may hold a wrong bit.
        undefined: messages left out for each channel number that nothing defines any more.
        without_schema: topics whose schema is lost; their messages are saved without.
        attachments: attachments saved.
        metadata: metadata records saved.
        damaged: what was left out: where, how much, why.
        lost_chunks: the chunks among it, with their times where something trustworthy tells them.
        doubted: the checksum over all of the data is wrong although no damage was found; then
            something without a checksum of its own is wrong.
        restored: chunks whose head was damaged and whose content was not; they are saved.
        complete: the damaged recording had its proper end.
    """

    source: str
    output: str
    size_bytes: int
    messages: Mapping[str, int]
    expected: Mapping[str, int] | None
    unproven: Mapping[str, int]
    undefined: Mapping[int, int]
    without_schema: tuple[str, ...]
    attachments: int
    metadata: int
    damaged: tuple[Damage, ...]
    lost_chunks: tuple[Damage, ...]
    doubted: bool
    restored: int
    complete: bool

    @property
    def skipped_bytes(self) -> int:
        """How much was left out."""
        return sum(damage.length_bytes for damage in self.damaged)

    @property
    def sound(self) -> bool:
        """Whether nothing was wrong with the recording."""
        left_out = self.damaged or self.undefined or self.without_schema
        return self.complete and not (left_out or self.doubted or self.restored)

    def as_json(self) -> dict[str, object]:
        """Return the report as JSON values, under the names of its attributes."""
        return asdict(self) | {"skipped_bytes": self.skipped_bytes, "sound": self.sound}

    def describe(self) -> list[str]:
        """Return the report as lines for people; what was saved comes first."""
        total = sum(self.messages.values())
        lines = [f"{self.output}: {total} messages of {self.source} ({self.size_bytes} bytes)"]
        lines += [self._topic_line(topic) for topic in sorted({*self.messages, *self._announced})]
        lines.append(f"  {self.metadata} metadata records, {self.attachments} attachments")
        lines += self._losses()
        lines += [
            f"left out: {number} messages of channel {channel}, which nothing defines"
            for channel, number in self.undefined.items()
        ]
        lines += [f"{topic}: its schema is lost" for topic in self.without_schema]
        if self.unproven:
            number = sum(self.unproven.values())
            lines.append(f"{number} messages have no checksum, or none for their topic's name")
        if self.doubted:
            lines.append("the checksum of the data differs: what has no checksum may be wrong")
        if self.restored:
            lines.append(f"{self.restored} chunks had a damaged head and are saved")
        if not self.complete:
            lines.append("the recording had no proper end; the copy has one")
        return lines

    def _losses(self) -> list[str]:
        """Return a line for each loss: a chunk that is all of a damaged part is told once."""
        chunks, lines = {chunk.offset: chunk for chunk in self.lost_chunks}, []
        for damage in self.damaged:
            chunk = chunks.get(damage.offset)
            if chunk is None or chunk.length_bytes < damage.length_bytes:
                lines.append(f"left out: {damage.describe()}")
                continue
            known = replace(damage, start_ns=chunk.start_ns, end_ns=chunk.end_ns)
            lines.append(f"lost chunk: {known.describe()}")
            del chunks[damage.offset]
        return [*lines, *(f"lost chunk: {chunk.describe()}" for chunk in chunks.values())]

    @property
    def _announced(self) -> Mapping[str, int]:
        return self.expected or {}

    def _topic_line(self, topic: str) -> str:
        line = f"  {topic}: {self.messages.get(topic, 0)} messages"
        return f"{line} of {self._announced[topic]}" if topic in self._announced else line
