"""What the recorder says about its sources while it records: /diagnostics, the ROS way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

from rosbags.typesys.stores import ros2_humble as ros

from acquisition.messages import ros_fields as fields
from drivers.faults import Faults

_LOST, _MENDED = "lost ", "mended "


class Level(IntEnum):
    """The levels of diagnostic_msgs/msg/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True, slots=True)
class DeviceStatus:
    """How one source is doing.

    Attributes:
        level: the worst of what is known.
        name: the source's name.
        message: one line for people.
        hardware_id: the device's serial number, or "".
        values: figures as text, with the unit in the key.
    """

    level: Level
    name: str
    message: str
    hardware_id: str
    values: Mapping[str, str]

    def faults(self) -> Faults:
        """Return the driver's own counts; values of others that are no counts are left out."""
        return Faults(_behind(_LOST, self.values), _behind(_MENDED, self.values))


def fault_values(faults: Faults) -> dict[str, int]:
    """Return a driver's counts as they stand in `DeviceStatus.values`."""
    lost = {_LOST + name: count for name, count in faults.lost.items()}
    return lost | {_MENDED + name: count for name, count in faults.mended.items()}


def _behind(prefix: str, values: Mapping[str, str]) -> dict[str, int]:
    return {
        key.removeprefix(prefix): int(value)
        for key, value in values.items()
        if key.startswith(prefix) and value.isdecimal()
    }


@dataclass(frozen=True, slots=True)
class Diagnostics:
    """How all sources were doing at one time, `t_ns`."""

    t_ns: int
    statuses: tuple[DeviceStatus, ...]


def encode_diagnostics(
    diagnostics: Diagnostics, t_ns: int, _sequence: int
) -> ros.diagnostic_msgs__msg__DiagnosticArray:
    """Return the ROS message."""
    return ros.diagnostic_msgs__msg__DiagnosticArray(
        fields.ros_header(t_ns, ""),
        [_encode_status(status) for status in diagnostics.statuses],
    )


def _encode_status(status: DeviceStatus) -> ros.diagnostic_msgs__msg__DiagnosticStatus:
    return ros.diagnostic_msgs__msg__DiagnosticStatus(
        int(status.level),
        status.name,
        status.message,
        status.hardware_id,
        [ros.diagnostic_msgs__msg__KeyValue(key, value) for key, value in status.values.items()],
    )


def decode_diagnostics(
    message: ros.diagnostic_msgs__msg__DiagnosticArray, _sequence: int
) -> Diagnostics:
    """Return what the message says; ValueError for a level that ROS does not know."""
    return Diagnostics(
        fields.stamp_ns(message.header),
        tuple(
            DeviceStatus(
                Level(status.level),
                status.name,
                status.message,
                status.hardware_id,
                {pair.key: pair.value for pair in status.values},
            )
            for status in message.status
        ),
    )
