"""CAN frames in, vehicle twists out, by a DBC file.

A twist needs a value of every signal in the layout. Signals may be spread over several frames
(one per wheel). A twist is emitted with the frame that completes the set: when every signal has a
value that no earlier twist used, and the oldest of them is at most the window older than the
newest. Older values are dropped, so a wheel that went silent yields no twist at all, never one
with a guessed wheel. A value that is not finite (a float signal may carry NaN) counts as missing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from drivers.errors import DriverError
from drivers.samples import CanFrameSample, WheelTwistSample
from drivers.wheels.skid_steer import twist, twist_sigmas
from drivers.wheels.vehicle_layout import ANGULAR_UNITS_RAD_S, LINEAR_UNITS_M_S, VehicleLayout

if TYPE_CHECKING:
    from cantools.database import Message
    from cantools.database.can import Database


@dataclass(slots=True)
class DecodeCounters:
    """Frames and values that gave no twist, since construction.

    Attributes:
        undecodable: frames of a known message whose data the DBC file does not fit.
        invalid_values: values that were not finite numbers.
        stale_values: values dropped because the rest of their set did not come in time.
    """

    undecodable: int = 0
    invalid_values: int = 0
    stale_values: int = 0


@dataclass(frozen=True, slots=True)
class _Input:
    """One signal: where it is, and the factor to rim speed in m/s, speed or yaw rate."""

    text: str
    signal: str
    factor: float


class TwistDecoder:
    """Decodes the frames of one vehicle.

    Args:
        layout: signals and geometry.
        window_s: the longest time between the first and the last frame of one set.

    Raises:
        DriverError: cantools is not installed, the DBC file cannot be read, or the layout names
            a message, signal or unit that is not in it.
    """

    def __init__(self, layout: VehicleLayout, window_s: float) -> None:
        self._layout = layout
        self._window_ns = round(window_s * 1e9)
        self._messages: dict[tuple[int, bool], tuple[Message, list[_Input]]] = {}
        texts = (*layout.left, *layout.right) or (layout.speed, layout.yaw_rate)
        self._texts = tuple(dict.fromkeys(texts))
        database = _load(layout)
        for text in self._texts:
            self._add_input(database, text)
        self._values: dict[str, tuple[int, float]] = {}
        self._sequence = 0
        self.counters = DecodeCounters()

    @property
    def missing(self) -> str:
        """The signals that have no unused value, for messages."""
        return ", ".join(text for text in self._texts if text not in self._values)

    def add(self, frame: CanFrameSample) -> WheelTwistSample | None:
        """Take one frame; return the twist that it completes, if any."""
        known = self._messages.get((frame.arbitration_id, frame.is_extended))
        # A frame without data is a request for the answer that has the same identifier.
        if known is None or frame.is_error or frame.is_remote or not frame.data:
            return None
        self._take_values(frame, *known)
        oldest_ns = frame.t_ns - self._window_ns
        stale = [text for text, (t_ns, _) in self._values.items() if t_ns < oldest_ns]
        for text in stale:
            del self._values[text]
        self.counters.stale_values += len(stale)
        return self._emit(frame.t_ns) if len(self._values) == len(self._texts) else None

    def _take_values(self, frame: CanFrameSample, message: Message, inputs: list[_Input]) -> None:
        from cantools.database import DecodeError

        try:
            decoded = message.decode(frame.data, decode_choices=False)
        except DecodeError:
            self.counters.undecodable += 1
            return
        for wanted in inputs:
            if not isinstance(decoded, dict) or wanted.signal not in decoded:
                continue  # a multiplexed message without this signal this time
            value = decoded[wanted.signal]
            if isinstance(value, int | float) and math.isfinite(value):
                self._values[wanted.text] = (frame.t_ns, value * wanted.factor)
            else:
                self._values.pop(wanted.text, None)
                self.counters.invalid_values += 1

    def _emit(self, t_ns: int) -> WheelTwistSample:
        layout, track_m = self._layout, self._layout.effective_track_m
        left_m_s = right_m_s = None
        if layout.left:
            left_m_s = self._mean(layout.left)
            right_m_s = self._mean(layout.right)
            speed_m_s, yaw_rate_rad_s = twist(left_m_s, right_m_s, track_m)
        else:
            speed_m_s = self._values[layout.speed][1]
            yaw_rate_rad_s = self._values[layout.yaw_rate][1] * layout.yaw_rate_scale
        self._values.clear()
        sigmas = twist_sigmas(
            yaw_rate_rad_s, layout.wheel_speed_sigma_m_s, track_m, layout.track_sigma_ratio
        )
        self._sequence += 1
        return WheelTwistSample(
            t_ns, speed_m_s, yaw_rate_rad_s, *sigmas, left_m_s, right_m_s, self._sequence - 1
        )

    def _mean(self, texts: tuple[str, ...]) -> float:
        return sum(self._values[text][1] for text in texts) / len(texts)

    def _add_input(self, database: Database, text: str) -> None:
        """Find `Message.Signal` in the DBC file; DriverError when it is not there."""
        message_name, _, signal_name = text.removeprefix("-").partition(".")
        signals = {m.name: [s.name for s in m.signals] for m in database.messages}
        if signal_name not in signals.get(message_name, ()):
            raise DriverError(
                f"no signal {text!r} in {self._layout.dbc_path}; its messages are "
                f"{', '.join(sorted(signals))}"
            )
        message = database.get_message_by_name(message_name)
        unit = message.get_signal_by_name(signal_name).unit
        factor = self._factor(text, unit) * (-1.0 if text.startswith("-") else 1.0)
        key = (message.frame_id, message.is_extended_frame)
        self._messages.setdefault(key, (message, []))[1].append(_Input(text, signal_name, factor))

    def _factor(self, text: str, unit: str | None) -> float:
        """Return the factor from the DBC file's unit to what the kinematics need."""
        layout = self._layout
        units = dict(LINEAR_UNITS_M_S)
        if text == layout.yaw_rate:
            units = dict(ANGULAR_UNITS_RAD_S)
        elif text != layout.speed:
            shaft_to_rim_m = layout.wheel_radius_m / layout.gear_ratio
            units |= {name: si * shaft_to_rim_m for name, si in ANGULAR_UNITS_RAD_S.items()}
        if unit not in units:
            raise DriverError(f"{text}: unit {unit!r} in the DBC file; expected {', '.join(units)}")
        return units[unit]


def _load(layout: VehicleLayout) -> Database:
    """Read the DBC file."""
    try:
        from cantools.database import load_file
        from cantools.database.can import Database
        from cantools.database.errors import Error
    except ModuleNotFoundError as error:
        raise DriverError("cantools is not installed; pip install 'terravibe[wheels]'") from error
    try:
        database = load_file(layout.dbc_path, database_format="dbc")
    except (OSError, UnicodeError, Error) as error:
        reason = " ".join(str(error).split())
        raise DriverError(f"cannot read DBC file {layout.dbc_path}: {reason}") from error
    if not isinstance(database, Database):
        raise DriverError(f"{layout.dbc_path} describes no CAN frames")
    return database
