"""What comes behind a record of a damaged file: all that may speak for the record's length."""

from __future__ import annotations

from acquisition.recovery.damaged_file import DamagedFile
from acquisition.recovery.record_checks import read_head, read_sound
from acquisition.stream.framing import HEAD, KNOWN_OPCODES, MAGIC


def record_follows(file: DamagedFile, offset: int) -> bool:
    """Tell whether the file ends at an offset, or goes on with what may be a record or the end."""
    rest = file.size_bytes - offset
    if rest < 0:
        return False
    if rest < HEAD.size:
        # The closing magic, or a record of which only these few bytes are left.
        left = file.read(offset, rest)
        return not left or left == MAGIC[: len(left)] or left[0] in KNOWN_OPCODES
    try:
        head = read_head(file, offset)
    except ValueError:
        return False
    return head.opcode in KNOWN_OPCODES or known_record_follows(file, head.end)


def known_record_follows(file: DamagedFile, offset: int) -> bool:
    """Tell whether the file ends at an offset, or goes on with a sound record of a known kind.

    Records of unknown kinds, of which nothing but the length is known, may lie before it.
    """
    try:
        while offset < file.size_bytes:
            head = read_head(file, offset)
            if head.opcode in KNOWN_OPCODES:
                return bool(read_sound(file, head))
            offset = head.end
    except ValueError:
        return False
    return offset == file.size_bytes
