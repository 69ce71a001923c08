"""Wheel speeds from the vehicle's CAN bus, by a DBC file.

The driver only listens. It returns every frame of the bus and, after the frame that completes
one, the vehicle's twist (when that is: see `twist_decoder`).

What goes wrong is an error of `read`, raised once the samples before it were returned:

- no frame for `silence_timeout_s`: the vehicle is off, or the bit rate is wrong;
- frames but no twist for `silence_timeout_s`: a wheel's controller is silent, or the layout wrong;
- the controller went bus-off (socketcan tells by an error frame; slcan cannot);
- the adapter is gone.

After an error the next `read` goes on: it listens again, and opens the bus again if it is gone.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from drivers.checks import check_positive
from drivers.errors import DriverError
from drivers.faults import Faults
from drivers.samples import CanFrameSample, WheelTwistSample
from drivers.source import SourceInfo
from drivers.wheels.can_link import CanCounters, CanLink
from drivers.wheels.twist_decoder import DecodeCounters, TwistDecoder
from drivers.wheels.vehicle_layout import vehicle_layout

# Linux uapi/linux/can/error.h: the class bit of an error frame that reports bus-off.
_CAN_ERR_BUSOFF = 0x40
_REOPEN_PAUSE_S = 0.2


class Wheels:
    """A `Source` of `CanFrameSample` and `WheelTwistSample`.

    Args:
        channel: can0, /dev/ttyACM0, ...
        name: how errors and records call this bus.
        interface: python-can's name of the kind of bus: socketcan, slcan, virtual, ...
        bitrate: in bit/s; of socketcan it is set with `ip link` instead.
        bus_options: further arguments of that python-can interface.
        vehicle: a name of `vehicle_layout.VEHICLES`, or "custom".
        layout: fields of `VehicleLayout` that differ from the vehicle's.
        set_window_s: the longest time between the first and the last frame of one twist.
        silence_timeout_s: the longest time without a frame, and without a twist.
        clock: CLOCK_MONOTONIC in nanoseconds.
        sleep: waits that many seconds.

    Raises:
        DriverError: no such vehicle, or a layout or a number that makes no sense.
    """

    def __init__(
        self,
        channel: str = "can0",
        *,
        name: str = "wheels",
        interface: str = "socketcan",
        bitrate: int = 500_000,
        bus_options: Mapping[str, object] | None = None,
        vehicle: str = "puma",
        layout: Mapping[str, object] | None = None,
        set_window_s: float = 0.05,
        silence_timeout_s: float = 1.0,
        clock: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        check_positive(f"{name}: bitrate", bitrate)
        check_positive(f"{name}: set_window_s", set_window_s)
        check_positive(f"{name}: silence_timeout_s", silence_timeout_s)
        self._name = name
        self._where = f"{interface}:{channel}"
        self._vehicle = vehicle
        self._layout = vehicle_layout(vehicle, layout or {})
        self._set_window_s = set_window_s
        self._silence_timeout_s = silence_timeout_s
        self._clock = clock
        self._sleep = sleep
        self._new_link = partial(CanLink, interface, channel, bitrate, bus_options or {}, clock)
        self._link = self._new_link()
        self._decoder: TwistDecoder | None = None
        self._is_open = False
        self._frame_ns = self._twist_ns = 0
        self._alarm = ""

    @property
    def name(self) -> str:
        """The instance's name."""
        return self._name

    @property
    def bus_counters(self) -> CanCounters:
        """Frames, error frames and garbled lines since `open`."""
        return self._link.counters

    @property
    def decode_counters(self) -> DecodeCounters:
        """Frames and values that gave no twist since `open`."""
        return self._decoder.counters if self._decoder else DecodeCounters()

    @property
    def faults(self) -> Faults:
        """Frames and values that gave nothing; what the bus itself repaired. Since `open`."""
        bus, decoding = self.bus_counters, self.decode_counters
        return Faults(
            {
                "garbled_frames": bus.garbled,
                "undecodable_frames": decoding.undecodable,
                "invalid_values": decoding.invalid_values,
                "stale_values": decoding.stale_values,
            },
            {"bus_error_frames": bus.error_frames},
        )

    def open(self) -> SourceInfo:
        """Read the DBC file and open the bus; a silent bus shows only in `read`.

        Raises:
            DriverError: the DBC file does not fit the layout, or the bus cannot be opened.
        """
        self.close()
        try:
            self._decoder = TwistDecoder(self._layout, self._set_window_s)
            self._link = self._new_link()
            self._link.open()
        except DriverError as error:
            raise self._error(error) from error
        self._is_open = True
        self._restart_watch()
        return SourceInfo(
            name=self._name,
            model=f"{self._vehicle} on {self._where}",
            serial="",
            produces=(CanFrameSample, WheelTwistSample),
            time_base="monotonic",
            details={
                "layout": self._layout.model_dump_json(exclude_defaults=True),
                "dbc": str(self._layout.dbc_path),
                "effective_track_m": f"{self._layout.effective_track_m:.6g}",
            },
        )

    def read(self, timeout_s: float) -> Sequence[CanFrameSample | WheelTwistSample]:
        """Return the frames that have arrived, each twist behind the frame that completed it.

        Raises:
            DriverError: not open, or one of the cases that the module names.
        """
        if self._decoder is None or not self._is_open:
            raise DriverError(f"{self._name}: not open; call open() first")
        self._raise_alarm()
        try:
            if not self._link.is_open:
                pause_s = min(timeout_s, _REOPEN_PAUSE_S)
                self._sleep(pause_s)
                timeout_s -= pause_s
                self._link.open()
                self._restart_watch()
            frames = self._link.receive(min(timeout_s, self._silence_timeout_s))
        except DriverError as error:
            raise self._error(error) from error
        samples = self._decode(self._decoder, frames)
        self._watch(self._decoder)
        if not samples:
            self._raise_alarm()
        return samples

    def close(self) -> None:
        """Release the bus."""
        self._is_open = False
        self._alarm = ""
        self._link.close()

    def _decode(
        self, decoder: TwistDecoder, frames: Sequence[CanFrameSample]
    ) -> list[CanFrameSample | WheelTwistSample]:
        samples: list[CanFrameSample | WheelTwistSample] = []
        for frame in frames:
            samples.append(frame)
            if frame.is_error and frame.arbitration_id & _CAN_ERR_BUSOFF:
                self._alarm = (
                    "bus-off: check wiring, termination and bit rate, then restart the bus"
                )
            elif not frame.is_error:
                self._frame_ns = frame.t_ns
            twist = decoder.add(frame)
            if twist is not None:
                self._twist_ns = twist.t_ns
                samples.append(twist)
        return samples

    def _watch(self, decoder: TwistDecoder) -> None:
        """Set the alarm when frames or twists stopped, and wait as long before the next one."""
        now_ns = self._clock()
        limit_ns = self._silence_timeout_s * 1e9
        if self._alarm or now_ns - self._twist_ns <= limit_ns:
            return
        if now_ns - self._frame_ns > limit_ns:
            what = "no CAN frame; is the vehicle on and the bit rate right?"
        else:
            what = f"CAN frames but no twist; nothing from {decoder.missing}"
        self._alarm = f"for {self._silence_timeout_s:g} s {what}"
        self._restart_watch()

    def _raise_alarm(self) -> None:
        alarm, self._alarm = self._alarm, ""
        if alarm:
            raise self._error(alarm)

    def _restart_watch(self) -> None:
        self._frame_ns = self._twist_ns = self._clock()

    def _error(self, reason: object) -> DriverError:
        return DriverError(f"{self._name}: {self._where}: {reason}")
