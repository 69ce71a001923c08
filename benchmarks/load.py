"""The full load of a rover, from fakes: what the benchmarks of the recorder record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from acquisition.messages import codec
from acquisition.messages.codec import MessageType
from acquisition.messages.motion import decode_acceleration, encode_acceleration
from drivers.samples import (
    AccelerationSample,
    CameraIntrinsics,
    DepthFrame,
    Float64Array,
    PoseSample,
    Sample,
    frozen_array,
)
from tests.fakes.paced_source import PacedSource

CAMERA = CameraIntrinsics(640, 480, 525.0, 525.0, 319.5, 239.5)
_DIFFERENT_FRAMES = 16
_DISPARITY_NOISE = 0.13


@dataclass(frozen=True, slots=True)
class GyroStandIn(AccelerationSample):
    """Stands for the yaw gyro's sample: written as the same ROS message."""


@dataclass(frozen=True, slots=True)
class CanStandIn(AccelerationSample):
    """Stands for a CAN frame: a larger message than that."""


# Stand-ins for what has no row of its own; replace each by the device's sample type.
STAND_INS: dict[str, type[Sample]] = {"/gyro": GyroStandIn, "/can": CanStandIn}


def add_stand_ins() -> None:
    """Let the stream write the stand-ins."""
    codec.MESSAGE_TYPES += tuple(
        MessageType(topic, "sensor_msgs/msg/Imu", kind, encode_acceleration, decode_acceleration)
        for topic, kind in STAND_INS.items()
    )


def sources() -> list[PacedSource]:
    """Return depth 30 Hz, vibration 1 kHz, gyro 400 Hz, CAN 500 Hz, motion capture 100 Hz."""
    frames = depth_frames()
    pose = PoseSample(
        0, frozen_array((1, 2, 0.3), (3,)), frozen_array((1, 0, 0, 0), (4,)), _covariance(), 0
    )

    def frame(number: int, t_ns: int) -> Sample:
        return replace(frames[number % len(frames)], t_ns=t_ns, sequence=number)

    def posed(number: int, t_ns: int) -> Sample:
        return replace(pose, t_ns=t_ns, sequence=number)

    return [
        PacedSource("vibration", 1000.0, AccelerationSample, _three_axes(AccelerationSample)),
        PacedSource("gyro", 400.0, GyroStandIn, _three_axes(GyroStandIn)),
        PacedSource("can", 500.0, CanStandIn, _three_axes(CanStandIn)),
        PacedSource("mocap", 100.0, PoseSample, posed),
        PacedSource("depth", 30.0, DepthFrame, frame),
    ]


def _three_axes(kind: type[AccelerationSample]) -> Callable[[int, int], Sample]:
    noise = np.random.default_rng(3).normal(0.0, 0.2, (1024, 3))
    values = [frozen_array(row, (3,)) for row in noise]

    def make(number: int, t_ns: int) -> Sample:
        return kind(t_ns, values[number % len(values)], number)

    return make


def _covariance() -> Float64Array:
    return frozen_array(np.diag([1e-6] * 3 + [1e-5] * 3), (6, 6))


def depth_frames() -> list[DepthFrame]:
    """Return frames as a Kinect V1 sees rough ground: steps of 1/8 px disparity, holes, shadow.

    Disparity d = d0 - f b / z with d0 = 1090 and f b = 348 px m, in eighths of a pixel; noise
    is such that zstd shrinks a frame about as much as a real one (5.7 times).
    """
    rng = np.random.default_rng(2)
    return [_depth_frame(number, rng) for number in range(_DIFFERENT_FRAMES)]


def _depth_frame(number: int, rng: np.random.Generator) -> DepthFrame:
    v, u = np.mgrid[0:480, 0:640].astype(np.float64)
    z_mm = 900.0 + 4.0 * (480.0 - v) + 60.0 * np.sin(u / 50.0 + number / 3.0)
    eighths = 8.0 * (1090.0 - 348_000.0 / z_mm) + rng.normal(0.0, _DISPARITY_NOISE, z_mm.shape)
    depth = 348_000.0 / (1090.0 - np.round(eighths) / 8.0)
    depth[(v // 12 + u // 9 + number) % 41 == 0] = 0.0
    depth[:, :20] = 0.0
    depth_mm = depth.astype(np.uint16)
    depth_mm.flags.writeable = False
    return DepthFrame(0, depth_mm, CAMERA, number)
