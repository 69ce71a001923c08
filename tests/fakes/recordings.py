"""Small recordings made of plain samples; what they do not fake: noise, jitter, a real scene."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from acquisition.clocks.clock_sample import ClockSample
from acquisition.messages.codec import Recordable
from acquisition.messages.frames import (
    DEPTH_OPTICAL_FRAME,
    MOCAP_BODY_FRAME,
    StaticTransform,
)
from acquisition.stream.byte_source import Pipe
from acquisition.stream.reader import StreamMessage, StreamReader
from acquisition.stream.writer import StreamWriter
from drivers.samples import (
    AccelerationSample,
    CameraIntrinsics,
    DepthFrame,
    PoseSample,
    Sample,
    frozen_array,
)
from drivers.source import SourceInfo

START_NS = 1_700_000_000_000_000_000
CAMERA = CameraIntrinsics(8, 6, 5.25, 5.5, 3.5, 2.5)
SOURCE = SourceInfo(
    "fake", "made of numbers", "7", (DepthFrame, PoseSample, AccelerationSample), "recorded"
)
SETTINGS = {"rate_hz": 30}
MOUNT = StaticTransform(
    MOCAP_BODY_FRAME,
    DEPTH_OPTICAL_FRAME,
    frozen_array((0.1, 0.2, 0.3), (3,)),
    frozen_array((0.6, 0.0, -0.8, 0.0), (4,)),
)


def depth_frame(number: int, t_ns: int = START_NS, camera: CameraIntrinsics = CAMERA) -> DepthFrame:
    """Return a frame whose pixels tell its number."""
    shape = (camera.height_px, camera.width_px)
    pixels = (np.arange(np.prod(shape)) * 7 + number * 13) % 5000
    depth_mm = pixels.astype(np.uint16).reshape(shape)
    depth_mm.flags.writeable = False
    return DepthFrame(t_ns, depth_mm, camera, number)


def pose(number: int, t_ns: int = START_NS) -> PoseSample:
    """Return a pose whose position tells its number."""
    quat = frozen_array((0.5, 0.5, -0.5, 0.5), (4,))
    return PoseSample(t_ns, frozen_array((number, 0.5, 1.5), (3,)), quat, _covariance(), number)


def _covariance() -> np.ndarray[Any, np.dtype[np.float64]]:
    return frozen_array(np.arange(36.0).reshape(6, 6) * 1e-6, (6, 6))


def acceleration(number: int, t_ns: int = START_NS) -> AccelerationSample:
    """Return a sample whose x tells its number."""
    return AccelerationSample(t_ns, frozen_array((number * 0.01, 0.0, 9.81), (3,)), number)


def clock_sample(number: int, t_ns: int = START_NS) -> ClockSample:
    """Return a sample of a device's clock whose ticks tell its number."""
    return ClockSample(
        t_ns=t_ns,
        source="kinect",
        host_monotonic_ns=5_000_000_000 + number,
        host_raw_ns=4_999_000_000 + number,
        host_real_ns=t_ns + 7,
        boot_id="8d0f4c2e",
        offset_ns=-number,
        skew_ppm=-39.5,
        device_ticks=2**63 + number,
        event="device_step" if number % 2 else "",
        event_ns=-1000 * number,
        sequence=number,
    )


def samples(seconds: float) -> list[Sample]:
    """Return depth at 30 Hz, poses at 100 Hz and accelerations at 200 Hz, in time order."""
    end_ns = START_NS + int(seconds * 1e9)
    made: list[Sample] = []
    for make, period_ns in (
        (depth_frame, 33_333_333),
        (pose, 10_000_000),
        (acceleration, 5_000_000),
    ):
        made += [make(i, t) for i, t in enumerate(range(START_NS, end_ns, period_ns))]
    return sorted(made, key=lambda sample: sample.t_ns)


def recording(
    content: Sequence[Sample | ClockSample], source: SourceInfo = SOURCE, **options: Any
) -> bytes:
    """Return the bytes of a recording of those samples."""
    stream = io.BytesIO()
    with StreamWriter(
        stream, sources=[source], static_transforms=[MOUNT], settings=SETTINGS, **options
    ) as writer:
        for sample in content:
            writer.write(sample)
    return stream.getvalue()


def reader_of(data: bytes, **options: Any) -> StreamReader:
    """Return a reader of those bytes."""
    return StreamReader(Pipe(io.BytesIO(data), "test"), **options)


def same(a: Recordable, b: Recordable) -> bool:
    """Tell whether two samples are equal bit for bit."""
    return type(a) is type(b) and bits(a) == bits(b)


def bits(value: object) -> object:
    """Return a sample, a message or a part of one as something that compares bit for bit."""
    if isinstance(value, np.ndarray):
        return (value.dtype.str, value.shape, value.tobytes())
    if isinstance(value, float):
        return struct.pack("<d", value)  # NaN is equal to nothing
    if isinstance(value, tuple):
        return tuple(bits(item) for item in value)
    if hasattr(value, "__slots__"):
        return tuple(bits(getattr(value, name)) for name in value.__slots__)
    return value


def fingerprint(messages: Iterable[StreamMessage]) -> list[object]:
    """Return what makes two read sequences equal bit for bit."""
    return [bits(message) for message in messages]
