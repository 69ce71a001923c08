"""What a reader found on its way: how much, and what was wrong with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Damage:
    """A part of the stream that was not handed on.

    Attributes:
        offset: where it starts in the stream, bytes.
        length_bytes: how long it is.
        reason: what is wrong with it.
        start_ns: log time of its first message according to its header; None = unknown.
        end_ns: log time of its last message according to its header; None = unknown.
    """

    offset: int
    length_bytes: int
    reason: str
    start_ns: int | None = None
    end_ns: int | None = None

    def describe(self) -> str:
        """Return one line."""
        line = f"{self.length_bytes} bytes at offset {self.offset}: {self.reason}"
        if self.start_ns is None or self.end_ns is None:
            return line
        span_s = (self.end_ns - self.start_ns) * 1e-9
        return f"{line}; log times {self.start_ns} to {self.end_ns} ns ({span_s:.3f} s)"


@dataclass(frozen=True, slots=True)
class ReadReport:
    """What was read so far.

    Attributes:
        name: of the byte source.
        bytes_read: length of all complete records, bytes.
        messages: readable messages for each topic that is understood, late ones included.
        skipped: messages for each other topic of the recording.
        late_messages: messages that came more than the reorder window late; not handed on.
        unprotected_messages: messages without a checksum.
        truncated_bytes: bytes behind the last complete record that make no record.
        damaged: what could not be used.
        complete: the stream was read to its proper end.
    """

    name: str
    bytes_read: int
    messages: Mapping[str, int]
    skipped: Mapping[str, int]
    late_messages: int
    unprotected_messages: int
    truncated_bytes: int
    damaged: tuple[Damage, ...]
    complete: bool

    def losses(self, when_late: str = "") -> list[str]:
        """Return a line for each part of the stream that was there and not handed on.

        Args:
            when_late: what to do about messages that came late, where there is an option for it.
        """
        lines = [f"not used, damaged: {damage.describe()}" for damage in self.damaged]
        if not self.complete:
            lines.append(
                f"{self.name} has no proper end: used up to the last whole part, "
                f"{self.bytes_read} bytes; {self.truncated_bytes} bytes behind it were not used"
            )
        if self.late_messages:
            lines.append(
                f"{self.late_messages} messages came more than the reorder window late and were "
                f"not used{when_late}"
            )
        return lines

    def describe(self) -> list[str]:
        """Return the report as lines for people; what went well comes first."""
        lines = [f"{self.name}: {self.bytes_read} bytes, {sum(self.messages.values())} messages"]
        lines += [f"  {topic}: {number}" for topic, number in self.messages.items()]
        lines += [f"  {topic}: {number}, not used" for topic, number in self.skipped.items()]
        lines += [f"damaged: {damage.describe()}" for damage in self.damaged]
        if self.late_messages:
            lines.append(
                f"{self.late_messages} messages came too late to be put into order and were left "
                "out; enlarge the reorder window"
            )
        if self.unprotected_messages:
            lines.append(f"{self.unprotected_messages} messages have no checksum")
        if not self.complete:
            lines.append(
                f"the recording has no proper end; {self.truncated_bytes} bytes are left over"
            )
        return lines
