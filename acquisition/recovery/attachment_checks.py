"""What speaks for an attachment of a damaged file: its checksum, and its form."""

from __future__ import annotations

import struct

from mcap.records import Attachment

from acquisition.stream.checksum import crc32
from acquisition.stream.chunks import parse

_TIMES_BYTES = 16
_CRC = struct.Struct("<I")


def has_checksum(body: bytes) -> bool:
    """Return whether an attachment has a checksum; a wrong one is a ValueError."""
    if len(body) < _CRC.size:
        raise ValueError(f"attachment record of {len(body)} bytes")
    (expected,) = _CRC.unpack(body[-_CRC.size :])
    if expected not in (0, crc32(memoryview(body)[: -_CRC.size])):
        raise ValueError("attachment checksum differs")
    return bool(expected)


def exact_attachment(body: bytes) -> Attachment:
    """Return the attachment that is exactly so long; ValueError where there is none."""
    attachment: Attachment = parse(Attachment.read, body)
    names = len(attachment.name.encode()) + len(attachment.media_type.encode())
    if len(body) != _TIMES_BYTES + 8 + names + 8 + len(attachment.data) + _CRC.size:
        raise ValueError("attachment record of another form than it must have")
    return attachment
