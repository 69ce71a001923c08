"""From the bytes of one frame to numbers in SI units: no port, no clock, no state."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from struct import Struct
from typing import Any, NamedTuple

from drivers.errors import DriverError
from drivers.samples import AccelerationSample, Sample, VibrationSample, frozen_array
from drivers.vibration.profile_tables import ValueField, VibrationProfile

Vector = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class FrameValues:
    """What one frame says.

    Attributes:
        fields: field name -> its value (1 or 3 numbers, x y z as the device sends them) in the
            field's SI unit; NaN for the invalid code and outside min..max.
        device_ticks: the device's clock, 0 .. wrap_ticks - 1; None where the frame has none.
    """

    fields: Mapping[str, Vector]
    device_ticks: int | None


class FrameDecoder:
    """Decodes the frames of one profile."""

    def __init__(self, profile: VibrationProfile) -> None:
        self._profile = profile
        self._fields = [_FieldReader(field) for field in profile.field]
        parts = profile.clock.part if profile.clock else ()
        self._clock = [(part.struct, part.offset, part.ticks) for part in parts]
        self._limits = [limit for reader in self._fields for limit in reader.limits()]
        self._limits += [
            _Limit(part.struct, part.offset, 1.0, 0.0, 0.0, part.max, None)
            for part in parts
            if part.max is not None
        ]

    def decode(self, frame: bytes) -> FrameValues:
        """Return the values in a frame.

        Raises:
            DriverError: the frame is shorter than the profile says.
        """
        self._require_length(frame)
        return FrameValues({f.name: f.values(frame) for f in self._fields}, self._ticks(frame))

    def plausible(self, frame: bytes) -> bool:
        """Tell whether every value, and every part of the clock, lies within its limits.

        The invalid code does, too.

        Raises:
            DriverError: the frame is shorter than the profile says.
        """
        self._require_length(frame)
        for reader, offset, scale, bias, low, high, invalid in self._limits:
            raw = reader.unpack_from(frame, offset)[0]
            if not low <= raw * scale + bias <= high and raw != invalid:
                return False
        return True

    def samples(self, values: FrameValues, t_ns: int, sequence: int) -> list[Sample]:
        """Return the samples of one frame, in the sensor's axes: vibration, then specific force."""
        spec = self._profile.sample
        nothing = (math.nan,) * 3
        signed = spec.statistic == "instantaneous"
        frequency = values.fields[spec.frequency] if spec.frequency else nothing
        temperature = values.fields[spec.temperature][0] if spec.temperature else None
        vibration = VibrationSample(
            t_ns=t_ns,
            amplitude=frozen_array(self._axes(values.fields[spec.amplitude], signed=signed), (3,)),
            frequency_hz=frozen_array(self._axes(frequency, signed=False), (3,)),
            quantity=spec.quantity,
            statistic=spec.statistic,
            temperature_c=temperature,
            sequence=sequence,
            device_ticks=values.device_ticks,
        )
        if spec.specific_force is None:
            return [vibration]
        force = frozen_array(self._axes(values.fields[spec.specific_force], signed=True), (3,))
        return [vibration, AccelerationSample(t_ns, force, sequence)]

    def _axes(self, channels: Vector, *, signed: bool) -> Vector:
        """Put device channels into the sensor's axes; an unsigned amplitude keeps its sign."""
        return tuple(
            -channels["xyz".index(axis[-1])]
            if signed and axis.startswith("-")
            else channels["xyz".index(axis[-1])]
            for axis in self._profile.sample.axes
        )

    def _ticks(self, frame: bytes) -> int | None:
        if self._profile.clock is None:
            return None
        total = sum(int(s.unpack_from(frame, at)[0]) * ticks for s, at, ticks in self._clock)
        return total % self._profile.clock.wrap_ticks

    def _require_length(self, frame: bytes) -> None:
        if len(frame) < self._profile.frame.shortest:
            raise DriverError(
                f"frame of {len(frame)} bytes; profile {self._profile.profile.name!r} expects "
                f"{self._profile.frame.shortest}; check the length in the profile"
            )


class _Limit(NamedTuple):
    """Where a number lies in the frame, and between what its value must lie."""

    struct: Struct
    offset: int
    scale: float
    bias: float
    low: float
    high: float
    invalid: int | None


class _FieldReader:
    """One field, with everything computed that can be computed once."""

    def __init__(self, field: ValueField) -> None:
        self.name = field.name
        self._field = field
        self._struct = field.struct
        # Half a count of slack, so that a limit written in decimals includes its own raw value.
        slack = abs(field.scale) / 2
        self._low = -math.inf if field.min is None else field.min - slack
        self._high = math.inf if field.max is None else field.max + slack

    def values(self, frame: bytes) -> Vector:
        """Return the value at each offset; NaN where it is not usable."""
        field, found = self._field, []
        for offset in field.offsets:
            raw: Any = self._struct.unpack_from(frame, offset)[0]
            value = raw * field.scale + field.bias
            usable = raw != field.invalid and self._low <= value <= self._high
            found.append(value if usable else math.nan)
        return tuple(found)

    def limits(self) -> list[_Limit]:
        """Return the limits that can tell a frame from other bytes, one for each offset."""
        field = self._field
        # Every integer is possible where there are no limits; a float may be NaN or infinite.
        if (self._low, self._high) == (-math.inf, math.inf) and field.type != "float32":
            return []
        return [
            _Limit(self._struct, at, field.scale, field.bias, self._low, self._high, field.invalid)
            for at in field.offsets
        ]
