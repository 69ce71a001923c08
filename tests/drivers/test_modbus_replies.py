"""Telling what a Modbus slave sent instead of the expected reply."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.vibration.checksums import crc16_modbus
from drivers.vibration.modbus_replies import refusal
from tests.drivers.test_vibration_decode import CAPTURED_REPLY

_REQUEST = bytes.fromhex("50 03 00 30 00 17 08 4A")


def _with_crc(text: str) -> bytes:
    data = bytes.fromhex(text)
    return data + crc16_modbus(data).to_bytes(2, "little")


@pytest.mark.parametrize(
    ("received", "kind", "text"),
    [
        (_with_crc("50 83 02"), "exception", "exception 2 (illegal register address)"),
        (b"\x00\xff" + _with_crc("50 83 0B"), "exception", "exception 11 (unknown)"),
        (_with_crc("51 03 02 00 00"), "wrong-slave", "slave 0x51 answered, not 0x50"),
        (_with_crc("51 83 02"), "wrong-slave", "slave 0x51"),
        (_with_crc("51 06 00 04 00 06"), "wrong-slave", "slave 0x51"),
    ],
)
def test_another_reply_is_recognised(received: bytes, kind: str, text: str) -> None:
    found = refusal(_REQUEST, received)
    assert found is not None
    assert found.kind == kind
    assert text in found.text


@pytest.mark.parametrize(
    "received",
    [
        b"",
        b"\x50",
        CAPTURED_REPLY,
        CAPTURED_REPLY[:32],
        _REQUEST,  # the echo of an RS-485 adapter
        _with_crc("50 83 02")[:-1],
        _with_crc("50 83 02")[:-1] + b"\x00",
    ],
)
def test_no_other_reply_is_seen_where_none_is(received: bytes) -> None:
    assert refusal(_REQUEST, received) is None


@settings(deadline=None)
@given(st.binary(max_size=100))
def test_any_bytes_do_no_harm(received: bytes) -> None:
    refusal(_REQUEST, received)
