"""One sample of every type, made of numbers; what they do not fake: a device."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import get_args

from drivers.samples import (
    CanFrameSample,
    DepthFrame,
    Sample,
    VibrationSample,
    WheelTwistSample,
    YawRateSample,
    frozen_array,
)
from drivers.source import SourceInfo
from tests.fakes.recordings import START_NS, acceleration, depth_frame, pose, recording

EVERYTHING = SourceInfo("rover", "made of numbers", "8", get_args(Sample), "recorded")


def vibration(number: int, t_ns: int = START_NS) -> VibrationSample:
    """Return a sample whose x tells its number and whose z has no value."""
    return VibrationSample(
        t_ns,
        frozen_array((number * 1e-6, 2e-6, math.nan), (3,)),
        frozen_array((37.0, 37.5, math.nan), (3,)),
        "displacement",
        "peak-to-peak",
        21.5,
        number,
        device_ticks=51_702_974 + number,
    )


def yaw_rate(number: int, t_ns: int = START_NS) -> YawRateSample:
    """Return a sample whose counts tell its number."""
    return YawRateSample(t_ns, number * 6.1e-5, 25.25, -number, number)


def can_frame(number: int, t_ns: int = START_NS) -> CanFrameSample:
    """Return an extended frame whose data tells its number."""
    data = number.to_bytes(4, "little")
    return CanFrameSample(
        t_ns,
        0x02021542,
        is_extended=True,
        is_remote=False,
        is_error=False,
        data=data,
        channel="can0",
        sequence=number,
    )


def wheel_twist(number: int, t_ns: int = START_NS) -> WheelTwistSample:
    """Return a sample whose speed tells its number."""
    return WheelTwistSample(t_ns, number * 0.01, 0.1, 0.013, 0.027, -0.2, 0.3, number)


def with_ticks(number: int, t_ns: int = START_NS) -> DepthFrame:
    """Return a depth frame of a camera that has a clock."""
    return dataclasses.replace(depth_frame(number, t_ns), device_ticks=33_000 * number)


MAKERS = (with_ticks, pose, acceleration, vibration, yaw_rate, can_frame, wheel_twist)


def one_of_each(number: int = 5, t_ns: int = START_NS) -> list[Sample]:
    """Return one sample of every type, all of the same time."""
    return [make(number, t_ns) for make in MAKERS]


def device_recording(content: Sequence[Sample]) -> bytes:
    """Return the bytes of a recording of samples of any type."""
    return recording(content, EVERYTHING)
