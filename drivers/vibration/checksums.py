"""Checksums that serial sensors put behind their frames."""

from __future__ import annotations

import binascii
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import reduce
from operator import xor


def _modbus_table() -> tuple[int, ...]:
    """Return the CRC of each byte for the reflected polynomial x^16 + x^15 + x^2 + 1."""
    table = []
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0xA001 if crc & 1 else 0)
        table.append(crc)
    return tuple(table)


_MODBUS_TABLE = _modbus_table()


def crc16_modbus(data: bytes) -> int:
    """Return the CRC-16 of Modbus RTU (start 0xFFFF, reflected 0x8005); sent low byte first.

    Over data that end in their own CRC, low byte first, it is 0.
    """
    crc = 0xFFFF
    for byte in data:
        crc = (crc >> 8) ^ _MODBUS_TABLE[(crc ^ byte) & 0xFF]
    return crc


@dataclass(frozen=True, slots=True)
class ChecksumKind:
    """How a checksum is computed and how many bytes it takes in a frame."""

    compute: Callable[[bytes], int]
    size: int


CHECKSUMS: Mapping[str, ChecksumKind] = {
    "sum8": ChecksumKind(lambda data: sum(data) & 0xFF, 1),
    "xor8": ChecksumKind(lambda data: reduce(xor, data, 0), 1),
    "sum16": ChecksumKind(lambda data: sum(data) & 0xFFFF, 2),
    "crc16-modbus": ChecksumKind(crc16_modbus, 2),
    "crc16-ccitt": ChecksumKind(lambda data: binascii.crc_hqx(data, 0xFFFF), 2),
}
