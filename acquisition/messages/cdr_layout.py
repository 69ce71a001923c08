"""Messages laid out in one step, for the types that come by the thousand a second.

rosbags serialises any message, field by field, from an object that must be made first; for small
messages that is most of what recording them costs. But the place of every field behind the header
is fixed once the frame's name is known. So one `struct` lays out the whole message, made from the
same definitions as rosbags' own code; a test compares the bytes.

CDR (OMG DDS-XTypes 1.3, 7.4.1, plain CDR version 1): four bytes that say little-endian, then the
fields, each aligned to its own size as counted from behind those four bytes; a string is its
length with the closing zero as uint32, and its bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from typing import TypeAlias

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc

from acquisition.messages.ros_fields import MAX_SECONDS, NS_PER_S, stamp_parts
from acquisition.messages.ros_types import typestore

# A message in pieces, so that the pixels of an image are not copied to stand behind its head.
Parts: TypeAlias = tuple[bytes | memoryview, ...]
Values: TypeAlias = tuple[float, ...]

_ENCAPSULATION = b"\x00\x01\x00\x00"
_HEADER_TYPE = "std_msgs/msg/Header"
_STAMP = struct.Struct("<iI")
_STAMP_AT = len(_ENCAPSULATION)
_CODES = {
    "bool": "?",
    "uint8": "B",
    "uint32": "I",
    "uint64": "Q",
    "int32": "i",
    "int64": "q",
    "float64": "d",
}


@lru_cache(maxsize=256)
def layout(
    ros_type: str, frame_id: str, before: Values = (), behind: Values = ()
) -> Callable[..., Parts]:
    """Return a function that takes the time in ns and the values of all fields behind the header.

    The values come in the order of the definition, the elements of arrays one by one, but those
    of a byte array as bytes. The function raises ValueError for a time that no stamp can tell,
    struct.error for a value that does not fit its field.

    Args:
        ros_type: a type that starts with a header and has no string or sequence behind it.
        frame_id: what the header names.
        before: values of the first fields, where those are always the same.
        behind: values of the last fields, likewise.
    """
    text = frame_id.encode() + b"\0"
    text_bytes = len(text)
    codes = list(_codes_behind_header(ros_type, _STAMP.size + 4 + text_bytes))
    last = len(codes) - len(behind)
    first = _packed(codes[: len(before)], before)
    final = _packed(codes[last:], behind)
    between = "".join(codes[len(before) : last])
    pack = struct.Struct(f"<4siII{text_bytes}s{_codes_of(first)}{between}{_codes_of(final)}").pack

    def lay_out(t_ns: int, *values: float | bytes) -> Parts:
        """Return the message with its stamp, in one piece."""
        seconds, nanoseconds = divmod(t_ns, NS_PER_S)
        if not 0 <= seconds <= MAX_SECONDS:
            stamp_parts(t_ns)  # which says what is wrong
        head = (_ENCAPSULATION, seconds, nanoseconds, text_bytes, text)
        return (pack(*head, *first, *values, *final),)

    return lay_out


def _packed(codes: Sequence[str], values: Values) -> tuple[bytes, ...]:
    """Return constant values as one piece, or none at all."""
    return (struct.pack("<" + "".join(codes), *values),) if values else ()


def _codes_of(pieces: tuple[bytes, ...]) -> str:
    return "".join(f"{len(piece)}s" for piece in pieces)


def _codes_behind_header(ros_type: str, size: int) -> Iterator[str]:
    """Give the struct code of each value, with the padding before it; the header ends at `size`."""
    (_, header), *fields = typestore().get_msgdef(ros_type).fields
    if header != (Nodetype.NAME, _HEADER_TYPE):
        raise ValueError(f"{ros_type} does not start with a header")
    for _, field in fields:
        for code, count in _codes(field):
            width = 1 if code[-1] == "s" else struct.calcsize(code)
            yield f"{-size % width}x{code}"
            yield from [code] * (count - 1)
            size += -size % width + count * struct.calcsize(code)


def _codes(field: FieldDesc) -> Iterator[tuple[str, int]]:
    """Give the struct codes of a field's leaves, with their number."""
    match field:
        case (Nodetype.BASE, (name, _)) if name in _CODES:
            yield _CODES[name], 1
        case (Nodetype.NAME, name):
            for _, part in typestore().get_msgdef(name).fields:
                yield from _codes(part)
        case (Nodetype.ARRAY, ((Nodetype.BASE, ("uint8", _)), count)):
            yield f"{count}s", 1
        case (Nodetype.ARRAY, ((Nodetype.BASE, (name, _)), count)) if name in _CODES:
            yield _CODES[name], count
        case _:
            raise ValueError(f"a message with {field} has no fixed layout")


def restamped(cdr: bytes, t_ns: int) -> bytes:
    """Return a message that starts with a header, with another time in its stamp."""
    stamp = _STAMP.pack(*stamp_parts(t_ns))
    return cdr[:_STAMP_AT] + stamp + cdr[_STAMP_AT + _STAMP.size :]
