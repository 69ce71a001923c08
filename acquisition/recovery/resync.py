"""Where a damaged file goes on: the next record behind the damage that can be believed."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterator, Sequence

from mcap.opcode import Opcode

from acquisition.recovery.damaged_file import PAGE_BYTES, DamagedFile
from acquisition.recovery.followers import record_follows
from acquisition.recovery.record_checks import (
    Head,
    lengths_agree,
    read_head,
    read_record,
    read_sound,
)
from acquisition.stream.framing import HEAD, KNOWN_OPCODES

# An opcode of the specification and a length below 2^28 + 2^24 bytes.
_LOOKS_LIKE_HEAD = re.compile(rb"[\x01-\x0f].{3}[\x00-\x10]\x00{4}", re.DOTALL)
# So many records, each ending where the next one starts, are no coincidence.
_CHAIN_RECORDS = 3
_CHECKED = (Opcode.CHUNK, Opcode.ATTACHMENT)


def next_record(file: DamagedFile, damaged_offset: int, listed_offsets: Sequence[int]) -> int:
    """Return the offset at which reading can go on; the size of the file where it cannot.

    A record with a checksum of its own counts wherever it is found. One without counts when
    further records follow it without a gap, and not inside a damaged record whose length is
    believable: there it would be content.

    Args:
        file: the file.
        damaged_offset: where a record should have started, or did start but is damaged.
        listed_offsets: where chunks start by the index of the recording, in file order; there a
            chunk is recognised even when its first bytes are damaged.
    """
    found = _search(file, damaged_offset)
    for number in range(bisect_right(listed_offsets, damaged_offset), len(listed_offsets)):
        offset = listed_offsets[number]
        if offset >= found:
            break
        if _is_chunk(file, offset):
            return offset
    return found


def _search(file: DamagedFile, damaged_offset: int) -> int:
    content_end = _believable_end(file, damaged_offset)
    for offset in _candidates(file, damaged_offset + 1):
        if _is_record(file, offset, unproven=offset >= content_end):
            return offset
    return file.size_bytes


def _is_chunk(file: DamagedFile, offset: int) -> bool:
    """Tell whether a chunk with a right checksum lies there, damaged head or not."""
    try:
        return read_record(file, offset).proven
    except ValueError:
        return False


def _believable_end(file: DamagedFile, offset: int) -> int:
    """Return where the damaged record ends if another one follows there, otherwise its start."""
    try:
        head = read_head(file, offset)
    except ValueError:
        return offset
    # Nothing inside a message record speaks for its length.
    if head.opcode == Opcode.MESSAGE or not _is_record(file, head.end, unproven=True):
        return offset
    return head.end


def _candidates(file: DamagedFile, offset: int) -> Iterator[int]:
    """Give every offset at which a record may start, in order."""
    while offset + HEAD.size <= file.size_bytes:
        window = file.peek(offset)
        if len(window) < HEAD.size:
            # The disk refuses what follows.
            offset = ((offset + len(window)) // PAGE_BYTES + 1) * PAGE_BYTES
            continue
        position = 0
        while found := _LOOKS_LIKE_HEAD.search(window, position):
            position = found.start() + 1
            yield offset + found.start()
        offset += len(window) - HEAD.size + 1


def _is_record(file: DamagedFile, offset: int, *, unproven: bool) -> bool:
    try:
        head = read_head(file, offset)
        # A private record has no form that could be checked.
        if head.opcode not in KNOWN_OPCODES or not lengths_agree(file, head):
            return False
        if head.opcode in _CHECKED and read_sound(file, head).proven:
            return True
        return unproven and _chain(file, head)
    except ValueError:
        return False


def _chain(file: DamagedFile, head: Head) -> bool:
    """Tell whether records follow one another from here, each of the right form."""
    for _ in range(_CHAIN_RECORDS):
        if not record_follows(file, head.end):
            return False
        if head.opcode != Opcode.MESSAGE and read_sound(file, head).proven:
            return True
        if head.opcode == Opcode.FOOTER or file.size_bytes - head.end < HEAD.size:
            return True
        head = read_head(file, head.end)
    return True
