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
from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import TypeAlias

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc

from acquisition.messages.ros_fields import stamp_parts
from acquisition.messages.ros_types import typestore

# A message in pieces, so that the pixels of an image are not copied to stand behind its head.
Parts: TypeAlias = tuple[bytes | memoryview, ...]

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
def layout(ros_type: str, frame_id: str) -> Callable[..., Parts]:
    """Return a function that takes the time in ns and the values of all fields behind the header.

    The values come in the order of the definition, the elements of arrays one by one. The
    function raises ValueError for a time that no stamp can tell, struct.error for a value that
    does not fit its field.

    Args:
        ros_type: a type that starts with a header and has no string or sequence behind it.
        frame_id: what the header names.
    """
    text = frame_id.encode() + b"\0"
    codes = [f"<4siII{len(text)}s"]
    size = _STAMP.size + 4 + len(text)
    (_, header), *fields = typestore().get_msgdef(ros_type).fields
    if header != (Nodetype.NAME, _HEADER_TYPE):
        raise ValueError(f"{ros_type} does not start with a header")
    for _, field in fields:
        for code, count in _codes(field):
            width = struct.calcsize(code)
            padding = -size % width
            codes.append(f"{padding}x{count}{code}")
            size += padding + count * width
    pack = struct.Struct("".join(codes)).pack

    def lay_out(t_ns: int, *values: float) -> Parts:
        return (pack(_ENCAPSULATION, *stamp_parts(t_ns), len(text), text, *values),)

    return lay_out


def _codes(field: FieldDesc) -> Iterator[tuple[str, int]]:
    """Give the struct codes of a field's leaves, with their number."""
    match field:
        case (Nodetype.BASE, (name, _)) if name in _CODES:
            yield _CODES[name], 1
        case (Nodetype.NAME, name):
            for _, part in typestore().get_msgdef(name).fields:
                yield from _codes(part)
        case (Nodetype.ARRAY, ((Nodetype.BASE, (name, _)), count)) if name in _CODES:
            yield _CODES[name], count
        case _:
            raise ValueError(f"a message with {field} has no fixed layout")


def restamped(cdr: bytes, t_ns: int) -> bytes:
    """Return a message that starts with a header, with another time in its stamp."""
    stamp = _STAMP.pack(*stamp_parts(t_ns))
    return cdr[:_STAMP_AT] + stamp + cdr[_STAMP_AT + _STAMP.size :]
