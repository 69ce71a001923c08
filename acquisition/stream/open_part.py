"""The part of a recording that is being written, and when it ends."""

from __future__ import annotations

from dataclasses import dataclass, field

from acquisition.recording.intake import Stamped
from acquisition.stream.writer import StreamWriter

# A time that does not come. Chunks are closed here, not by the writer below: what is not yet
# flushed is kept, to be written again where there is room.
NEVER = 2**62


@dataclass(frozen=True, slots=True)
class PartLimits:
    """When a part ends; 0 = never.

    Attributes:
        size_bytes: after compression.
        duration_ns: from the first to the last log time.
    """

    size_bytes: int = 0
    duration_ns: int = 0


NO_LIMITS = PartLimits()

# A chunk each flush interval of 50 ms and one each second for the health, with some to spare; the
# entry of a chunk of ten topics takes 50 bytes.
_CHUNKS_PER_S = 22
_INDEX_BYTES_PER_CHUNK = 60
_LEAST_INDEX_BYTES, _MOST_INDEX_BYTES = 1 << 16, 1 << 23
_INDEX_BYTES_WITHOUT_DURATION = 1 << 20  # 13 minutes


def expected_index_bytes(limits: PartLimits) -> int:
    """Return what the chunk index of a part will take; at most 8 MB, which is 100 minutes."""
    if not limits.duration_ns:
        return _INDEX_BYTES_WITHOUT_DURATION
    expected = limits.duration_ns * _CHUNKS_PER_S * _INDEX_BYTES_PER_CHUNK // 1_000_000_000
    return min(max(expected, _LEAST_INDEX_BYTES), _MOST_INDEX_BYTES)


@dataclass(slots=True)
class OpenPart:
    """The part in progress; it ends before the first item of `ends_ns` or later.

    Attributes:
        writer: writes it.
        limits: when it ends.
        first_ns: the first log time; -1 before any.
        last_ns: the latest log time.
        ends_ns: see above.
        pending: what is in no complete chunk.
        pending_bytes: its size before compression.
        flushed: number of items in complete chunks.
    """

    writer: StreamWriter
    limits: PartLimits
    first_ns: int = -1
    last_ns: int = -1
    ends_ns: int = NEVER
    pending: list[Stamped] = field(default_factory=list)
    pending_bytes: int = 0
    flushed: int = 0

    def took(self, item: Stamped, size_bytes: int) -> None:
        """Take note that the writer has an item."""
        if self.first_ns < 0:
            self.first_ns = self.last_ns = item.log_time_ns
            if self.limits.duration_ns:
                self.ends_ns = item.log_time_ns + self.limits.duration_ns
        elif item.log_time_ns > self.last_ns:
            self.last_ns = item.log_time_ns
        self.pending.append(item)
        self.pending_bytes += size_bytes

    def flush(self) -> None:
        """Close the chunk; if that fails, `pending` is what is in no complete chunk."""
        before = self.writer.bytes_written
        try:
            self.writer.flush()
        finally:
            # A chunk and its index are two records; the chunk alone is enough to be read.
            if self.writer.bytes_written > before:
                self.flushed += len(self.pending)
                self.pending.clear()
                self.pending_bytes = 0
        limit_bytes = self.limits.size_bytes
        if limit_bytes and self.flushed and self.writer.bytes_written >= limit_bytes:
            self.ends_ns = 0
