"""The full load of a rover, from fakes: what the benchmarks of the recorder record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from drivers.samples import (
    CameraIntrinsics,
    CanFrameSample,
    DepthFrame,
    PoseSample,
    Sample,
    VibrationSample,
    YawRateSample,
    frozen_array,
)
from drivers.source import TickCounter
from tests.fakes.paced_source import PacedSource

CAMERA = CameraIntrinsics(640, 480, 525.0, 525.0, 319.5, 239.5)
_TICKS_PER_US = 60
KINECT_COUNTER = TickCounter(1e6 * _TICKS_PER_US, 1 << 32)
_DIFFERENT_FRAMES = 16
_DISPARITY_NOISE = 0.13
_DIFFERENT_SAMPLES = 1024
_GYRO_RAD_S = 1.2e-3  # one count

Make = Callable[[int, int], Sample]


def sources() -> list[PacedSource]:
    """Return depth 30 Hz, vibration 1 kHz, gyro 400 Hz, CAN 500 Hz, motion capture 100 Hz."""
    return [
        PacedSource("vibration", 1000.0, VibrationSample, _vibration()),
        PacedSource("gyro", 400.0, YawRateSample, _yaw_rate()),
        PacedSource("can", 500.0, CanFrameSample, _can_frame()),
        PacedSource("mocap", 100.0, PoseSample, _pose()),
        PacedSource("depth", 30.0, DepthFrame, _depth(), counter=KINECT_COUNTER),
    ]


def _vibration() -> Make:
    """Give signed waves, as the devices that reach 1 kHz send them: without a frequency."""
    noise = np.random.default_rng(3).normal(0.0, 0.2, (_DIFFERENT_SAMPLES, 3))
    values = [frozen_array(row, (3,)) for row in noise]
    unknown = frozen_array((np.nan,) * 3, (3,))

    def make(number: int, t_ns: int) -> Sample:
        value = values[number % _DIFFERENT_SAMPLES]
        return VibrationSample(
            t_ns, value, unknown, "acceleration", "instantaneous", None, number, None
        )

    return make


def _yaw_rate() -> Make:
    counts = np.random.default_rng(4).integers(-900, 900, _DIFFERENT_SAMPLES).tolist()

    def make(number: int, t_ns: int) -> Sample:
        count = counts[number % _DIFFERENT_SAMPLES]
        return YawRateSample(t_ns, count * _GYRO_RAD_S, 31.5, count, number)

    return make


def _can_frame() -> Make:
    data = np.random.default_rng(5).bytes(8 * _DIFFERENT_SAMPLES)

    def make(number: int, t_ns: int) -> Sample:
        start = 8 * (number % _DIFFERENT_SAMPLES)
        return CanFrameSample(
            t_ns,
            arbitration_id=0x200 + number % 4,
            is_extended=False,
            is_remote=False,
            is_error=False,
            data=data[start : start + 8],
            channel="can0",
            sequence=number,
        )

    return make


def _pose() -> Make:
    position_m = frozen_array((1.0, 2.0, 0.3), (3,))
    quat_wxyz = frozen_array((1.0, 0.0, 0.0, 0.0), (4,))
    covariance = frozen_array(np.diag([1e-6] * 3 + [1e-5] * 3), (6, 6))

    def make(number: int, t_ns: int) -> Sample:
        return PoseSample(t_ns, position_m, quat_wxyz, covariance, number)

    return make


def _depth() -> Make:
    frames = depth_frames()

    def make(number: int, t_ns: int) -> Sample:
        return replace(
            frames[number % len(frames)],
            t_ns=t_ns,
            sequence=number,
            device_ticks=t_ns * _TICKS_PER_US // 1000 % (1 << 32),
        )

    return make


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
