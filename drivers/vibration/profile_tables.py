"""What a vibration sensor's profile file may say: the frame layout as data, never as code.

Each class is one table of the TOML file and each attribute one key; units are in the key's name
or in its description. Offsets count bytes from the first sync byte. docs/devices/vibration.md
explains how to write a profile for another device.
"""

from __future__ import annotations

import struct
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import PydanticCustomError

from drivers.samples import VibrationQuantity, VibrationStatistic
from drivers.vibration.checksums import CHECKSUMS, ChecksumKind

IntegerType = Literal["int8", "uint8", "int16", "uint16", "int32", "uint32"]
NumberType = Literal[IntegerType, "float32"]
ByteOrder = Literal["little", "big"]
Unit = Literal["m", "m/s", "m/s^2", "Hz", "degC", "rad"]
Axis = Literal["x", "y", "z", "-x", "-y", "-z"]
_STRUCT_CODES = {
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "float32": "f",
}


def _bytes_from_hex(value: object) -> object:
    """Turn "55 61" into bytes; anything else is a fault in the profile."""
    try:
        return bytes.fromhex(value) if isinstance(value, str) else value
    except ValueError:
        raise PydanticCustomError("hex", "bytes in hexadecimal, such as '55 61'") from None


HexBytes = Annotated[bytes, BeforeValidator(_bytes_from_hex)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Name = Annotated[str, Field(min_length=1)]


class Table(BaseModel):
    """One table of a profile: unknown keys fail, nothing is converted silently."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class Number(Table):
    """How a number lies in the frame."""

    type: NumberType
    byte_order: ByteOrder

    @property
    def struct(self) -> struct.Struct:
        """The `struct` that reads it."""
        return struct.Struct(("<" if self.byte_order == "little" else ">") + self._code)

    @property
    def size(self) -> int:
        """Bytes it takes."""
        return self.struct.size

    @property
    def _code(self) -> str:
        return _STRUCT_CODES[self.type]


class Identity(Table):
    """`[profile]`: what device this is about and how far the layout can be trusted."""

    name: Name
    device: Name
    source: Name = Field(description="where the layout was found")
    verified: bool = Field(description="true: checked against bytes of a real device")


class SerialSettings(Table):
    """`[serial]`: the port."""

    baud: Annotated[int, Field(gt=0)]
    data_bits: Literal[7, 8]
    parity: Literal["none", "even", "odd"]
    stop_bits: Literal[1, 2]

    def byte_ns(self, baud: int | None = None) -> float:
        """Return the time that one byte takes on the wire, ns, at `baud` or the usual speed."""
        bits = 1 + self.data_bits + (self.parity != "none") + self.stop_bits
        return bits * 1e9 / (baud or self.baud)


class Link(Table):
    """`[link]`: who speaks first, and how often."""

    mode: Literal["poll", "stream"]
    nominal_rate_hz: Positive
    identify_within_s: Positive = Field(description="a frame must arrive within this time")


class Poll(Table):
    """`[poll]`: one request, one frame in reply."""

    request: Annotated[HexBytes, Field(min_length=1)]
    reply_within_s: Positive
    retries: Annotated[int, Field(ge=0)] = Field(description="further requests before giving up")
    modbus: bool = Field(description="tell Modbus exceptions and other slaves' replies apart")


class Step(Table):
    """`[[start]]` or `[[stop]]`: bytes to send, and the reply that proves they were understood."""

    what: Name
    send: Annotated[HexBytes, Field(min_length=1)]
    reply: HexBytes = Field(b"", description="how the reply begins")
    reply_length: Annotated[int, Field(ge=0)] = Field(0, description="0: no reply is awaited")
    reply_within_s: Positive = 0.5
    baud: Annotated[int, Field(gt=0)] | None = Field(None, description="if not that of [serial]")


class Checksum(Table):
    """`[frame.checksum]`: negative offsets count from the end of the frame."""

    algorithm: Literal["none", "sum8", "xor8", "sum16", "crc16-modbus", "crc16-ccitt"]
    span: tuple[int, int] | None = Field(None, description="first byte, and one past the last")
    offset: int | None = None
    byte_order: ByteOrder | None = None

    @property
    def kind(self) -> ChecksumKind | None:
        """How to compute it; None where frames carry none."""
        return CHECKSUMS.get(self.algorithm)


class LengthField(Number):
    """`[frame.length_field]`: the frame tells its length: number at `offset` plus `add`."""

    type: IntegerType
    offset: Annotated[int, Field(ge=0)]
    add: int
    min: Annotated[int, Field(gt=0)]
    max: Annotated[int, Field(gt=0)]


class FrameSpec(Table):
    """`[frame]`: how to find a frame in the stream."""

    sync: Annotated[HexBytes, Field(min_length=1)]
    length: Annotated[int, Field(gt=0)] | None = None
    length_field: LengthField | None = None
    following_syncs: Annotated[int, Field(ge=0)] = Field(
        0, description="without a checksum: frames whose sync must follow at the right distance"
    )
    checksum: Checksum

    @property
    def shortest(self) -> int:
        """Length of the shortest frame, bytes."""
        return self.length or (self.length_field.min if self.length_field else 0)


class ValueField(Number):
    """`[[field]]`: one offset for a scalar, three for the x, y and z channel.

    value = raw * scale + bias, in `unit`. A value outside min..max, or equal to the raw code
    `invalid`, becomes NaN. A value outside min..max also speaks against the bytes being a frame:
    without a checksum it is then none, with one only if the next frame follows at once.
    """

    name: Name
    offsets: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=1, max_length=3)]
    scale: Finite
    bias: Finite = 0.0
    unit: Unit
    min: Finite | None = None
    max: Finite | None = None
    invalid: int | None = None


class ClockPart(Number):
    """`[[clock.part]]`: a number in the frame that counts for `ticks` ticks each.

    A number above `max` speaks against the bytes being a frame.
    """

    type: IntegerType
    offset: Annotated[int, Field(ge=0)]
    ticks: Annotated[int, Field(gt=0)]
    max: Annotated[int, Field(gt=0)] | None = None


class Clock(Table):
    """`[clock]`: the device's own clock, the sum of its parts."""

    tick_s: Positive
    wrap_ticks: Annotated[int, Field(gt=0)]
    part: Annotated[tuple[ClockPart, ...], Field(min_length=1)]


class SampleSpec(Table):
    """`[sample]`: which fields make up the sample.

    `axes` names the device channel, with its sign, that is the sensor's x, y and z. The sign
    counts for signed quantities only: an amplitude is never negative.
    """

    amplitude: Name
    quantity: VibrationQuantity
    statistic: VibrationStatistic
    axes: tuple[Axis, Axis, Axis]
    frequency: Name | None = None
    band_hz: tuple[Positive, Positive] | None = Field(None, description="where both are valid")
    temperature: Name | None = None
    specific_force: Name | None = Field(None, description="acceleration with gravity")


class VibrationProfile(Table):
    """A whole profile file."""

    profile: Identity
    serial: SerialSettings
    link: Link
    poll: Poll | None = None
    start: tuple[Step, ...] = ()
    stop: tuple[Step, ...] = ()
    frame: FrameSpec
    field: Annotated[tuple[ValueField, ...], Field(min_length=1)]
    clock: Clock | None = None
    sample: SampleSpec

    def field_named(self, name: str) -> ValueField | None:
        """Return the field of that name, or None."""
        return next((field for field in self.field if field.name == name), None)
