"""Says what a Modbus RTU slave sent instead of the expected reply.

Frames of the Modbus application protocol over a serial line: address, function, data, CRC-16.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from drivers.vibration.checksums import crc16_modbus

_EXCEPTION_BIT = 0x80
_EXCEPTIONS = {
    1: "illegal function",
    2: "illegal register address",
    3: "illegal value",
    4: "device failure",
    6: "device busy",
}


@dataclass(frozen=True, slots=True)
class Refusal:
    """A correct Modbus reply that is not the one asked for."""

    kind: Literal["exception", "wrong-slave"]
    text: str


def refusal(request: bytes, received: bytes) -> Refusal | None:
    """Return why the received bytes hold no answer to the request, if Modbus says so.

    Bytes in front of the reply are skipped; None when no other reply is (yet) among them.
    """
    for start in range(len(received)):
        reply = _reply_at(received, start)
        if reply is None:
            continue
        if reply[0] != request[0]:
            return Refusal("wrong-slave", f"slave {reply[0]:#04x} answered, not {request[0]:#04x}")
        if reply[1] == request[1] | _EXCEPTION_BIT:
            name = _EXCEPTIONS.get(reply[2], "unknown")
            return Refusal("exception", f"the slave answered exception {reply[2]} ({name})")
    return None


def _reply_at(received: bytes, start: int) -> bytes | None:
    """Return the reply with a correct CRC that begins there, or None."""
    function = received[start + 1 : start + 2]
    if not function:
        return None
    if function[0] & _EXCEPTION_BIT:
        length = 5
    elif function[0] in (3, 4) and len(received) > start + 2:
        length = 5 + received[start + 2]
    else:
        length = 8
    reply = received[start : start + length]
    return reply if len(reply) == length and crc16_modbus(reply) == 0 else None
