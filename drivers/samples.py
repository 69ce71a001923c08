"""Frozen samples: what a device said, in SI units and in the device's own axes.

Times are integer nanoseconds. `t_ns` is CLOCK_MONOTONIC for a live device, stamped once right
after the read returned, and the recorded time for a source that plays files; `SourceInfo` says
which. Arrays are read-only, so that a sample can be handed to several threads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Float64Array = NDArray[np.float64]


def frozen_array(values: object, shape: tuple[int, ...]) -> Float64Array:
    """Return `values` as a read-only float64 array of the given shape.

    Raises:
        ValueError: the values do not have that shape.
    """
    array = np.array(values, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"expected shape {shape}, found {array.shape}")
    array.flags.writeable = False
    return array


@dataclass(frozen=True, slots=True)
class CameraIntrinsics:
    """Pinhole model without distortion, in pixels.

    The optical frame has x right, y down, z forward (REP 103); pixel centres are at integer
    coordinates, so a point (x, y, z) is seen at u = fx x/z + cx, v = fy y/z + cy.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float


@dataclass(frozen=True, slots=True)
class DepthFrame:
    """One depth image.

    Attributes:
        t_ns: time of the frame.
        depth_mm: (height, width) uint16, distance along the optical axis in millimetres;
            0 = no return.
        camera: the intrinsics that belong to this image size.
        sequence: frame counter of the source, starting at 0; a gap means lost frames.
        device_ticks: the device's own counter, unwrapped by nobody; None where it has none.
    """

    t_ns: int
    depth_mm: NDArray[np.uint16]
    camera: CameraIntrinsics
    sequence: int
    device_ticks: int | None = None


@dataclass(frozen=True, slots=True)
class PoseSample:
    """Pose of a tracked body in a fixed world frame whose z axis points up.

    Attributes:
        t_ns: time of the pose.
        position_m: (3,) origin of the body in the world, metres.
        quat_wxyz: (4,) unit quaternion, body axes to world axes.
        covariance: (6, 6) of (x, y, z, rotation about world x, y, z): m^2, m rad, rad^2.
        sequence: counter of the source, starting at 0.
    """

    t_ns: int
    position_m: Float64Array
    quat_wxyz: Float64Array
    covariance: Float64Array
    sequence: int


@dataclass(frozen=True, slots=True)
class AccelerationSample:
    """Specific force of a triaxial accelerometer, gravity included, in the chip's axes.

    Attributes:
        t_ns: time of the sample.
        acceleration_m_s2: (3,) m/s^2; a chip at rest with z up reads (0, 0, +9.8).
        sequence: counter of the source, starting at 0.
    """

    t_ns: int
    acceleration_m_s2: Float64Array
    sequence: int


@dataclass(frozen=True, slots=True)
class YawRateSample:
    """Angular rate about the one axis that a gyro senses.

    Attributes:
        t_ns: time of the sample.
        rate_rad_s: rad/s about the chip's sensing axis, right-handed, bias not removed.
        temperature_c: the chip's latest own temperature in degrees Celsius; None where it
            reports no absolute temperature or has not reported one yet.
        raw_counts: the signed register value that `rate_rad_s` was scaled from; None only in
            recordings of other programs.
        sequence: counter of the source, starting at 0; a gap means lost samples, as far as the
            driver can tell.
    """

    t_ns: int
    rate_rad_s: float
    temperature_c: float | None
    raw_counts: int | None
    sequence: int


@dataclass(frozen=True, slots=True)
class CanFrameSample:
    """One CAN frame as it was on the bus.

    Attributes:
        t_ns: host time right after the frame was read; adapters' own stamps differ in their base.
        arbitration_id: 11 or 29 bits; of an error frame the error class bits of Linux.
        is_extended: the identifier has 29 bits.
        is_remote: a request without data.
        is_error: not a frame of the bus but the controller's report of an error on it.
        data: 0 to 8 bytes.
        channel: the interface or port that it came from.
        sequence: counter of the source's frames, starting at 0.
    """

    t_ns: int
    arbitration_id: int
    is_extended: bool
    is_remote: bool
    is_error: bool
    data: bytes
    channel: str
    sequence: int


@dataclass(frozen=True, slots=True)
class WheelTwistSample:
    """Motion of the vehicle as its wheels tell it; wrong under slip.

    Axes: x forward, z up, at the middle between the wheels.

    Attributes:
        t_ns: time of the newest frame that it was made of.
        speed_m_s: forward speed.
        yaw_rate_rad_s: about z, counter-clockwise.
        speed_sigma_m_s: standard deviation of the speed.
        yaw_rate_sigma_rad_s: standard deviation of the yaw rate.
        left_m_s: mean rim speed of the left wheels; None when the vehicle reports none.
        right_m_s: of the right wheels.
        sequence: counter of the source's twists, starting at 0.
    """

    t_ns: int
    speed_m_s: float
    yaw_rate_rad_s: float
    speed_sigma_m_s: float
    yaw_rate_sigma_rad_s: float
    left_m_s: float | None
    right_m_s: float | None
    sequence: int


VibrationQuantity = Literal["displacement", "velocity", "acceleration"]
VibrationStatistic = Literal["peak", "peak-to-peak", "rms", "instantaneous"]


@dataclass(frozen=True, slots=True)
class VibrationSample:
    """Amplitude and frequency of the vibration along three axes, as the device measured them.

    A device that sends several quantities gives the one that its profile names as the amplitude.

    Attributes:
        t_ns: time of the sample.
        amplitude: (3,) in the sensor's axes: m, m/s or m/s^2 according to `quantity`; NaN where
            the device sent its code for "no value". Not negative, unless instantaneous.
        frequency_hz: (3,) dominant frequency of each axis, Hz; NaN where there is none.
        quantity: what the amplitude is an amplitude of.
        statistic: which amplitude of the oscillation it is; "instantaneous" is the signed wave
            itself, as some devices send it at a high rate and without a frequency.
        temperature_c: temperature of the device, degrees Celsius; None where it sends none.
        sequence: counter of the source, starting at 0.
        device_ticks: the device's own clock, unwrapped by nobody; None where it sends none.
    """

    t_ns: int
    amplitude: Float64Array
    frequency_hz: Float64Array
    quantity: VibrationQuantity
    statistic: VibrationStatistic
    temperature_c: float | None
    sequence: int
    device_ticks: int | None = None


Sample = (
    DepthFrame
    | PoseSample
    | AccelerationSample
    | VibrationSample
    | YawRateSample
    | CanFrameSample
    | WheelTwistSample
)
