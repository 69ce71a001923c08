"""Vibration as terravibe_msgs/msg/TriaxialVibration; reasons of failure as ValueError."""

from __future__ import annotations

from collections.abc import Mapping

from acquisition.messages import ros_fields as fields
from acquisition.messages.cdr_layout import Parts, layout
from acquisition.messages.frames import VIBRATION_FRAME
from acquisition.messages.ros_types import RosMessage
from drivers.samples import VibrationQuantity, VibrationSample, VibrationStatistic

VIBRATION_TYPE = "terravibe_msgs/msg/TriaxialVibration"

# The constants of the .msg file; 0 is none of them, so that a field nobody set is noticed.
QUANTITIES: Mapping[VibrationQuantity, int] = {
    "displacement": 1,
    "velocity": 2,
    "acceleration": 3,
}
STATISTICS: Mapping[VibrationStatistic, int] = {
    "peak": 1,
    "peak-to-peak": 2,
    "rms": 3,
    "instantaneous": 4,
}
_QUANTITY_OF = {code: word for word, code in QUANTITIES.items()}
_STATISTIC_OF = {code: word for word, code in STATISTICS.items()}


def encode_vibration(sample: VibrationSample, t_ns: int, sequence: int) -> Parts:
    """Return the vibration; host_receive_ns repeats the stamp, which nobody has translated yet."""
    quantity, statistic = QUANTITIES.get(sample.quantity), STATISTICS.get(sample.statistic)
    if quantity is None or statistic is None:
        raise ValueError(f"{sample.quantity!r}, {sample.statistic!r} is no known amplitude")
    return layout(VIBRATION_TYPE, VIBRATION_FRAME)(
        t_ns,
        t_ns,
        fields.integer("sequence", sequence, 0, fields.MAX_UINT32),
        *fields.three_or_nan("amplitude", sample.amplitude),
        *fields.three_or_nan("frequency", sample.frequency_hz),
        quantity,
        statistic,
        *fields.flagged("temperature", sample.temperature_c),
        *fields.flagged_integer("device ticks", sample.device_ticks, 0, fields.MAX_UINT64),
    )


def decode_vibration(message: RosMessage, _sequence: int) -> VibrationSample:
    """Return the vibration at the time of the stamp, with the number that its source gave it."""
    if message.quantity not in _QUANTITY_OF:
        raise ValueError(f"quantity is {message.quantity}; expected 1 to {len(QUANTITIES)}")
    if message.statistic not in _STATISTIC_OF:
        raise ValueError(f"statistic is {message.statistic}; expected 1 to {len(STATISTICS)}")
    return VibrationSample(
        fields.stamp_ns(message.header),
        fields.no_infinity("amplitude", message.amplitude, (3,)),
        fields.no_infinity("frequency", message.frequency_hz, (3,)),
        _QUANTITY_OF[message.quantity],
        _STATISTIC_OF[message.statistic],
        fields.unflagged("temperature", message.has_temperature, message.temperature_c),
        message.sequence,
        message.device_ticks if message.has_device_ticks else None,
    )
