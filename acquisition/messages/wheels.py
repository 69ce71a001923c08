"""CAN frames, twists of the wheels and speeds of both sides; reasons of failure as ValueError."""

from __future__ import annotations

import math

import numpy as np
from rosbags.typesys.stores import ros2_humble as ros

from acquisition.messages import ros_fields as fields
from acquisition.messages.cdr_layout import Parts, layout
from acquisition.messages.companions import Companion
from acquisition.messages.frames import WHEELS_FRAME
from acquisition.messages.ros_types import RosMessage
from drivers.samples import CanFrameSample, WheelTwistSample

CAN_TYPE = "can_msgs/msg/Frame"
SPEEDS_TYPE = "terravibe_msgs/msg/WheelSpeeds"
TWIST_TYPE = "geometry_msgs/msg/TwistWithCovarianceStamped"

_MAX_ID = 2**29 - 1
_MAX_STANDARD_ID = 2**11 - 1
_MAX_DATA_BYTES = 8

# Of what wheels cannot tell, (m/s)^2 and (rad/s)^2: sigma of 1000, which is no knowledge at all.
_UNKNOWN_VARIANCE = 1e6
_USELESS_COVARIANCE: list[float] = np.diag([_UNKNOWN_VARIANCE] * 6).ravel().tolist()
_SPEED, _YAW_RATE = 0, 35  # places of the variances of x and of rotation about z among the 6 x 6


def encode_can(frame: CanFrameSample, t_ns: int, _sequence: int) -> Parts:
    """Return the frame; unused data bytes are 0."""
    used = len(frame.data)
    if used > _MAX_DATA_BYTES:
        raise ValueError(f"the frame has {used} bytes; expected 0 to {_MAX_DATA_BYTES}")
    return layout(CAN_TYPE, frame.channel)(
        t_ns,
        _checked_id(frame.arbitration_id, short=not (frame.is_extended or frame.is_error)),
        frame.is_remote,
        frame.is_extended,
        frame.is_error,
        used,
        frame.data,  # the layout fills up the rest with zeros
    )


def decode_can(message: RosMessage, sequence: int) -> CanFrameSample:
    """Return the frame, its data as long as the message says."""
    if message.dlc > _MAX_DATA_BYTES:
        raise ValueError(f"the frame has {message.dlc} bytes; expected 0 to {_MAX_DATA_BYTES}")
    return CanFrameSample(
        fields.stamp_ns(message.header),
        _checked_id(message.id, short=not (message.is_extended or message.is_error)),
        is_extended=message.is_extended,
        is_remote=message.is_rtr,
        is_error=message.is_error,
        data=message.data[: message.dlc].tobytes(),
        channel=message.header.frame_id,
        sequence=sequence,
    )


def _checked_id(arbitration_id: int, *, short: bool) -> int:
    longest = _MAX_STANDARD_ID if short else _MAX_ID
    return fields.integer("arbitration id", arbitration_id, 0, longest)


def encode_twist(sample: WheelTwistSample, t_ns: int, _sequence: int) -> Parts:
    """Return forward speed and yaw rate; the other motions are 0 with a useless variance."""
    covariance = _USELESS_COVARIANCE.copy()
    covariance[_SPEED] = _variance("speed", sample.speed_sigma_m_s)
    covariance[_YAW_RATE] = _variance("yaw rate", sample.yaw_rate_sigma_rad_s)
    speed_m_s = fields.finite_number("speed", sample.speed_m_s)
    yaw_rate_rad_s = fields.finite_number("yaw rate", sample.yaw_rate_rad_s)
    linear, angular = (speed_m_s, 0.0, 0.0), (0.0, 0.0, yaw_rate_rad_s)
    return layout(TWIST_TYPE, WHEELS_FRAME)(t_ns, *linear, *angular, *covariance)


def decode_twist(
    message: ros.geometry_msgs__msg__TwistWithCovarianceStamped, sequence: int
) -> WheelTwistSample:
    """Return forward speed and yaw rate; the speeds of both sides are in the companion, if any."""
    twist, covariance = message.twist.twist, message.twist.covariance
    return WheelTwistSample(
        fields.stamp_ns(message.header),
        fields.finite_number("speed", twist.linear.x),
        fields.finite_number("yaw rate", twist.angular.z),
        _sigma("speed", float(covariance[_SPEED])),
        _sigma("yaw rate", float(covariance[_YAW_RATE])),
        None,
        None,
        sequence,
    )


def _variance(what: str, sigma: float) -> float:
    """Return sigma^2, of which the root is sigma again, bit for bit, unless it under- or overflows.

    Source: S. Boldo, "Stupid is as stupid does: taking the square root of the square of a
    floating-point number", 2015: exact in base 2 with rounding to nearest.
    """
    variance = sigma * sigma
    if not (sigma >= 0.0 and math.sqrt(variance) == sigma < math.inf):
        raise ValueError(f"sigma of the {what} is {sigma}; expected 0 or 1e-150 to 1e150")
    return variance


def _sigma(what: str, variance: float) -> float:
    if not 0.0 <= variance < math.inf:
        raise ValueError(f"variance of the {what} is {variance}; expected finite, not negative")
    return math.sqrt(variance)


def encode_speeds(sample: WheelTwistSample, t_ns: int, _sequence: int) -> Parts | None:
    """Return the speeds of both sides, or None for a vehicle that reports none."""
    if sample.left_m_s is None and sample.right_m_s is None:
        return None
    return layout(SPEEDS_TYPE, WHEELS_FRAME)(
        t_ns,
        *fields.flagged("left speed", sample.left_m_s),
        *fields.flagged("right speed", sample.right_m_s),
    )


def decode_speeds(message: RosMessage, _sequence: int) -> Companion:
    """Return the speeds of both sides for the twist with the same stamp."""
    return Companion(
        fields.stamp_ns(message.header),
        WheelTwistSample,
        {
            "left_m_s": fields.unflagged("left speed", message.has_left, message.left_m_s),
            "right_m_s": fields.unflagged("right speed", message.has_right, message.right_m_s),
        },
    )
