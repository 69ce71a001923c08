"""The chunk index of the part in progress, which MCAP wants behind the last chunk.

It is all that a recorder must remember of what it has written. Compressed, a chunk's entry is 50
bytes; at 21 chunks a second that is 60 kB a minute, by which a recorder's memory would grow until
the part ends. So the memory that a part will need is claimed, and touched, before the recording
begins; each part uses it again, and only a part with more chunks than expected makes it grow.
"""

from __future__ import annotations

from collections.abc import Iterator

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import McapRecord

_BLOCK_BYTES = 1 << 15  # before compression; larger ones are hardly smaller after it
_UNTOUCHED = b"\xff"  # memory full of zeros would not be there before it is used


class IndexStore:
    """Records in the order in which they were added, compressed in blocks."""

    def __init__(self, expected_bytes: int = 0) -> None:
        """Claim so much memory for compressed blocks."""
        self._memory = bytearray(_UNTOUCHED) * expected_bytes
        self._block_ends: list[int] = []
        self._newest = RecordBuilder()
        self._compressor = zstandard.ZstdCompressor()

    @property
    def claimed_bytes(self) -> int:
        """Memory for compressed blocks, used or not."""
        return len(self._memory)

    @property
    def used_bytes(self) -> int:
        """How much of it is used."""
        return self._block_ends[-1] if self._block_ends else 0

    def clear(self) -> None:
        """Forget all records and keep the memory."""
        self._block_ends.clear()
        self._newest.end()

    def add(self, record: McapRecord) -> None:
        """Put a record behind the others."""
        record.write(self._newest)
        if self._newest.count >= _BLOCK_BYTES:
            block, start = self._compressor.compress(self._newest.end()), self.used_bytes
            self._memory[start : start + len(block)] = block  # which grows where it must
            self._block_ends.append(start + len(block))

    def take(self) -> Iterator[bytes]:
        """Give all records, a few hundred at a time, and forget them."""
        start = 0
        for end in self._block_ends:
            yield zstandard.decompress(self._memory[start:end])
            start = end
        yield self._newest.end()
        self.clear()
