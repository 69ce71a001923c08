"""Checksums against published check values."""

from __future__ import annotations

import pytest

from drivers.vibration.checksums import CHECKSUMS, crc16_modbus


@pytest.mark.parametrize(
    ("algorithm", "expected"),
    [
        ("sum8", 0xDD),
        ("xor8", 0x31),
        ("sum16", 0x01DD),
        ("crc16-modbus", 0x4B37),  # check value of CRC-16/MODBUS
        ("crc16-ccitt", 0x29B1),  # check value of CRC-16/CCITT-FALSE
    ],
)
def test_the_digits_1_to_9(algorithm: str, expected: int) -> None:
    assert CHECKSUMS[algorithm].compute(b"123456789") == expected


def test_a_message_of_the_manual_ends_in_its_own_crc() -> None:
    # WTVB01-485 manual, section 6.2: unlock.
    assert crc16_modbus(bytes.fromhex("500600 69B588 22A1")) == 0
