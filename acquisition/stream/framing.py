"""MCAP records out of bytes: complete records only, bounded lengths, one running checksum.

Format: https://mcap.dev/spec. A record is an opcode (1 byte), a length (uint64) and that many
bytes; a file is magic, records up to the Footer, and the magic again.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

from mcap.opcode import Opcode

from acquisition.errors import StreamError
from acquisition.stream.byte_source import ByteSource
from acquisition.stream.checksum import crc32

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
MAX_RECORD_BYTES = 256 << 20
_READ_BYTES = 1 << 20
_HDF5 = b"\x89HDF\r\n\x1a\n"  # what a NetCDF-4 file begins with
FIRST_PRIVATE_OPCODE = 0x80
KNOWN_OPCODES = frozenset(int(opcode) for opcode in Opcode)


@dataclass(frozen=True, slots=True)
class RawRecord:
    """One record as it lies in the stream.

    Attributes:
        offset: position of its opcode in the stream, bytes.
        opcode: what it is.
        body: its content.
        crc_before: crc32 of everything before it, since the stream's start or, in the summary
            section, since the end of the DataEnd record; what DataEnd and Footer vouch for.
    """

    offset: int
    opcode: int
    body: bytes
    crc_before: int

    @property
    def length_bytes(self) -> int:
        """Its length in the stream, opcode and length field included."""
        return HEAD.size + len(self.body)


class RecordFramer:
    """Cuts a byte source into records; how the bytes arrive makes no difference.

    Attributes:
        offset: position behind the last complete record, bytes.
        ended_well: the Footer and the closing magic were seen.
        lost: why the next record cannot be found, or "" when it can.
    """

    def __init__(self, source: ByteSource, max_record_bytes: int = MAX_RECORD_BYTES) -> None:
        self.offset = 0
        self.ended_well = False
        self.lost = ""
        self._source = source
        self._max_record_bytes = max_record_bytes
        self._ahead = bytearray()
        self._crc = 0

    def records(self) -> Iterator[RawRecord]:
        """Give every complete record, the Footer last; once.

        Raises:
            StreamError: this is no MCAP stream, or the source failed.
        """
        self._check_magic()
        while (record := self._next()) is not None:
            yield record
            if record.opcode == Opcode.FOOTER:
                self.ended_well = self._take(len(MAGIC)) == MAGIC
                return

    def left_over_bytes(self) -> int:
        """Return how many bytes follow the last complete record, without waiting for more."""
        return len(self._ahead) + self._source.skip_rest()

    def _check_magic(self) -> None:
        start = self._take(len(MAGIC))
        if start is None:
            found = f"only {len(self._ahead)} bytes" if self._ahead else "nothing"
            raise StreamError(f"{self._source.name} holds {found}; expected an MCAP recording")
        if start != MAGIC:
            found = "is NetCDF" if start == _HDF5 else f"starts with {start.hex(' ')}"
            raise StreamError(f"{self._source.name} {found}; expected an MCAP recording")

    def _next(self) -> RawRecord | None:
        """Return the next record, or None at the end or when it cannot be found."""
        if not self._fill(HEAD.size):
            return None
        opcode, length = HEAD.unpack_from(self._ahead)
        if opcode not in KNOWN_OPCODES and opcode < FIRST_PRIVATE_OPCODE:
            self.lost = f"no record starts here (opcode 0x{opcode:02x})"
        elif length > self._max_record_bytes:
            self.lost = f"record of {length} bytes; at most {self._max_record_bytes} are accepted"
        if self.lost:
            return None
        offset, crc_before = self.offset, self._crc
        whole = self._take(HEAD.size + length)
        if whole is None:
            return None
        if opcode == Opcode.DATA_END:
            self._crc = 0
        return RawRecord(offset, opcode, whole[HEAD.size :], crc_before)

    def _take(self, count: int) -> bytes | None:
        """Consume exactly `count` bytes, or nothing when there are not so many."""
        if not self._fill(count):
            return None
        taken = bytes(self._ahead[:count])
        del self._ahead[:count]
        self.offset += count
        self._crc = crc32(taken, self._crc)
        return taken

    def _fill(self, count: int) -> bool:
        """Read until `count` bytes lie ahead; false when the source ends before."""
        while len(self._ahead) < count:
            data = self._source.read(_READ_BYTES)
            if not data:
                return False
            self._ahead += data
        return True
