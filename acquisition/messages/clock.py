"""Clock samples as terravibe_msgs/msg/ClockSample; reasons of failure as ValueError."""

from __future__ import annotations

import math

from acquisition.clocks.clock_sample import ClockSample
from acquisition.messages import ros_fields as fields
from acquisition.messages.ros_types import RosMessage, ros_class

CLOCK_TYPE = "terravibe_msgs/msg/ClockSample"
_UNSIGNED = ("host_monotonic_ns", "host_raw_ns", "host_real_ns", "device_ticks")
_SIGNED = ("offset_ns", "event_ns")


def encode_clock(sample: ClockSample, t_ns: int, _sequence: int) -> object:
    """Return the sample as a message."""
    ticks = sample.device_ticks
    values = {name: getattr(sample, name) or 0 for name in (*_UNSIGNED, *_SIGNED)}
    _check_range({name: values[name] for name in _UNSIGNED}, 0, 2**64 - 1)
    _check_range({name: values[name] for name in _SIGNED}, -(2**63), 2**63 - 1)
    if not math.isfinite(sample.skew_ppm):
        raise ValueError(f"skew is not finite: {sample.skew_ppm}")
    return ros_class(CLOCK_TYPE)(
        header=fields.ros_header(t_ns, sample.source),
        boot_id=sample.boot_id,
        has_device_ticks=ticks is not None,
        skew_ppm=sample.skew_ppm,
        event=sample.event,
        **values,
    )


def _check_range(values: dict[str, int], least: int, most: int) -> None:
    for name, value in values.items():
        if not least <= value <= most:
            raise ValueError(f"{name} is {value}; expected {least} to {most}")


def decode_clock(message: RosMessage, sequence: int) -> ClockSample:
    """Return what a message says."""
    if not math.isfinite(message.skew_ppm):
        raise ValueError(f"skew is not finite: {message.skew_ppm}")
    return ClockSample(
        t_ns=fields.stamp_ns(message.header),
        source=message.header.frame_id,
        host_monotonic_ns=message.host_monotonic_ns,
        host_raw_ns=message.host_raw_ns,
        host_real_ns=message.host_real_ns,
        boot_id=message.boot_id,
        offset_ns=message.offset_ns,
        skew_ppm=message.skew_ppm,
        device_ticks=message.device_ticks if message.has_device_ticks else None,
        event=message.event,
        event_ns=message.event_ns,
        sequence=sequence,
    )
