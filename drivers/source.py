"""What every device looks like to the recorder, and the table of device names.

Life of a source: construct (touches nothing), `open` (all or nothing: on failure everything that
was acquired is released again), `read` until `EndOfSource` or until nobody wants more, `close`
(as often as you like). The same object may be opened again after `close`.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Literal, Protocol, Self, cast

from drivers.errors import DriverError
from drivers.faults import Faults
from drivers.samples import Sample

TimeBase = Literal["monotonic", "recorded"]


@dataclass(frozen=True, slots=True)
class TickCounter:
    """A device's own clock, whose reading its samples carry as `device_ticks`.

    Attributes:
        rate_hz: nominal ticks per second.
        wrap_ticks: how many different values it has before it starts over; None when it never
            does.
    """

    rate_hz: float
    wrap_ticks: int | None = None


@dataclass(frozen=True, slots=True)
class SourceInfo:
    """What `open` found.

    Attributes:
        name: the instance's name, as it appears in errors, health records and metadata.
        model: what kind of device answered.
        serial: its serial number, or "" where it has none.
        produces: the sample types that `read` may return.
        time_base: "monotonic" when `t_ns` is CLOCK_MONOTONIC of this host, "recorded" when the
            samples carry the times of an earlier recording.
        details: further identity and settings that were read back, as text.
        nominal_rate_hz: expected samples per second for each type where it is known.
        counter: the device's own clock; None where its samples carry none.
    """

    name: str
    model: str
    serial: str
    produces: tuple[type[Sample], ...]
    time_base: TimeBase
    details: Mapping[str, str] = field(default_factory=dict)
    nominal_rate_hz: Mapping[type[Sample], float] = field(default_factory=dict)
    counter: TickCounter | None = None


class Source(Protocol):
    """A device, or files that stand for one."""

    @property
    def name(self) -> str:
        """The instance's name."""

    @property
    def faults(self) -> Faults:
        """What did not become a sample, or nearly did not; counts never shrink while open.

        What shows as a gap in the samples' own sequence numbers need not be counted.
        """

    def open(self) -> SourceInfo:
        """Find the device, check its identity, make it ready.

        Raises:
            DriverError: not there, not the expected device, or refused; nothing stays open.
        """

    def read(self, timeout_s: float) -> Sequence[Sample]:
        """Return the next samples in time order, waiting at most `timeout_s` seconds.

        An empty sequence means that nothing arrived in time.

        Raises:
            DriverError: not open, unplugged, or broken; the message names the device.
            EndOfSource: a finite source has given its last sample.
        """

    def close(self) -> None:
        """Release everything; harmless when nothing is open."""


class OpenSource:
    """`with OpenSource(source) as opened:` opens on entry and closes on every way out.

    Attributes:
        info: what `open` found; None before.
    """

    def __init__(self, source: Source) -> None:
        self._source = source
        self.info: SourceInfo | None = None

    def __enter__(self) -> Self:
        self.info = self._source.open()
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._source.close()


# Device kind -> "module:Class". Imported on use, so that a missing optional library only
# matters to those who use that device.
SOURCES: Mapping[str, str] = {
    "tum": "drivers.depth.files:TumFolder",
    "png": "drivers.depth.files:MillimetrePngFolder",
    "openni": "drivers.depth.openni_depth:OpenNiDepth",
    "gyro": "drivers.gyro.yaw_gyro:YawGyro",
    "wheels": "drivers.wheels.can_wheels:Wheels",
    "mocap": "drivers.mocap.motion_capture:MotionCapture",
    "vibration": "drivers.vibration.sensor:VibrationSensor",
}


def source_class(kind: str) -> Callable[..., Source]:
    """Return what constructs the sources of that kind.

    Raises:
        DriverError: the kind is not in the table.
    """
    if kind not in SOURCES:
        raise DriverError(f"no device kind {kind!r}; expected one of {', '.join(sorted(SOURCES))}")
    module_name, class_name = SOURCES[kind].split(":")
    return cast(Callable[..., Source], getattr(importlib.import_module(module_name), class_name))


def make_source(kind: str, /, **settings: object) -> Source:
    """Construct the source of that kind; touches no device.

    Raises:
        DriverError: the kind is not in the table, or the driver refuses a setting.
    """
    return source_class(kind)(**settings)
