"""Receiving CAN frames through python-can, which knows the adapters, and around its traps.

- Frames are waited for with select() on the bus's descriptor: `recv` measures its time-out with
  the wall clock, which may jump, and its Notifier dies with the first listener that raises.
- slcan turns a garbled line into a bare ValueError or IndexError; it is counted and skipped. A
  byte above 127 would stay in its buffer and break every later line, so the port strips bit 7.
- slcan accepts a cut-off data field, and identifiers that do not exist; such frames are counted.
- Closing an slcan port that was unplugged raises before the descriptor is closed.
- Adapters stamp with their own clock, the wall clock or since boot: `t_ns` is taken here instead.
"""

from __future__ import annotations

import fcntl
import select
import socket
import termios
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from drivers.errors import DriverError
from drivers.samples import CanFrameSample

if TYPE_CHECKING:
    from can import BusABC, Message

_BATCH = 512
_SLCAN_DEFAULTS: Mapping[str, object] = {"sleep_after_open": 0.1}


@dataclass(slots=True)
class CanCounters:
    """What came over the bus since the link was made.

    Attributes:
        frames: frames received, error frames included; the next frame's sequence number.
        error_frames: reports of errors on the bus.
        garbled: what arrived as a frame but is no valid frame of classic CAN.
    """

    frames: int = 0
    error_frames: int = 0
    garbled: int = 0


class CanLink:
    """One bus.

    Args:
        interface: python-can's name: socketcan, slcan, virtual, ...
        channel: can0, /dev/ttyACM0, ...
        bitrate: in bit/s; of socketcan it is set with `ip link` instead.
        options: further arguments of that python-can interface.
        clock: CLOCK_MONOTONIC in nanoseconds.
    """

    def __init__(
        self,
        interface: str,
        channel: str,
        bitrate: int,
        options: Mapping[str, object],
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._interface = interface
        self._channel = channel
        defaults = _SLCAN_DEFAULTS if interface == "slcan" else {}
        self._options: dict[str, Any] = {**defaults, "bitrate": bitrate, **options}
        self._clock = clock
        self._bus: BusABC | None = None
        self._failure: Exception | None = None
        self._descriptor: int | None = None
        self.counters = CanCounters()

    @property
    def is_open(self) -> bool:
        """Whether a bus is held."""
        return self._bus is not None

    def open(self) -> None:
        """Open the bus.

        Raises:
            DriverError: python-can is not installed or cannot open it; nothing stays open.
        """
        try:
            import can
        except ModuleNotFoundError as error:
            raise DriverError(
                "python-can is not installed; pip install 'terravibe[wheels]'"
            ) from error
        try:
            if self._interface == "socketcan":  # python-can would leak a socket on a wrong name
                socket.if_nametoindex(self._channel)
            # ignore_config: a ~/.canrc must not change what the configuration says.
            self._bus = can.Bus(
                interface=self._interface,
                channel=self._channel,
                ignore_config=True,
                **self._options,
            )
            self._prepare(self._bus)
        except (can.CanError, OSError, ValueError, TypeError, NotImplementedError) as error:
            self.close()
            raise DriverError(f"cannot open the bus: {error}; {self._advice}") from error

    def _prepare(self, bus: BusABC) -> None:
        """Find the descriptor to wait on; make a serial port ours, and ASCII only."""
        with suppress(NotImplementedError):
            self._descriptor = bus.fileno()
        if self._interface != "slcan" or self._descriptor is None:
            return
        # Two readers would each get half of the bytes; pyserial's `exclusive` locks the same way.
        fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        try:
            settings = termios.tcgetattr(self._descriptor)
            settings[0] |= termios.ISTRIP
            termios.tcsetattr(self._descriptor, termios.TCSANOW, settings)
        except termios.error as error:
            raise OSError(*error.args) from error

    @property
    def _advice(self) -> str:
        if self._interface == "socketcan":
            bitrate = self._options["bitrate"]
            return f"is it up? ip link set {self._channel} up type can bitrate {bitrate}"
        return f"is it plugged in, and may this user open {self._channel}?"

    def close(self) -> None:
        """Release the bus; harmless when it is not open."""
        bus, self._bus = self._bus, None
        self._failure = self._descriptor = None
        if bus is None:
            return
        import can

        with suppress(can.CanError, OSError):
            bus.shutdown()
        port = getattr(bus, "serialPortOrig", None)  # slcan leaves it open when it was unplugged
        if port is not None:
            with suppress(OSError):
                port.close()

    def receive(self, timeout_s: float) -> list[CanFrameSample]:
        """Return what has arrived, waiting at most `timeout_s` for the first frame.

        Raises:
            DriverError: not open, or the bus is gone; it is closed then.
        """
        if self._bus is None:
            raise DriverError("not open; call open() first")
        deadline_ns = self._clock() + round(timeout_s * 1e9)
        frames: list[CanFrameSample] = []
        while not frames and self._failure is None:
            left_s = max(0.0, (deadline_ns - self._clock()) / 1e9)
            if self._descriptor is None:  # only in-process buses have none
                self._drain(self._bus, frames, left_s)
                break
            if not select.select([self._descriptor], [], [], left_s)[0]:
                break
            self._drain(self._bus, frames, 0.0)
        if frames or self._failure is None:
            return frames
        failure = self._failure
        self.close()
        cause = failure.__cause__ or failure  # python-can hides the errno in the cause
        raise DriverError(f"the bus is gone: {cause}; {self._advice}") from failure

    def _drain(self, bus: BusABC, frames: list[CanFrameSample], wait_s: float) -> None:
        """Append what can be read at once; keep a failure for after the frames before it."""
        from can import CanError

        for _ in range(_BATCH):
            try:
                message = bus.recv(wait_s)
            except (ValueError, IndexError):
                self.counters.garbled += 1
                continue
            except (CanError, OSError) as error:
                self._failure = error
                return
            if message is None:
                return
            wait_s = 0.0
            self._keep(message, frames)

    def _keep(self, message: Message, frames: list[CanFrameSample]) -> None:
        t_ns = self._clock()
        longest_id = 0x1FFFFFFF if message.is_extended_id else 0x7FF
        whole = message.is_remote_frame or len(message.data) == message.dlc <= 8
        if not whole or message.arbitration_id > longest_id:
            self.counters.garbled += 1
            return
        frames.append(
            CanFrameSample(
                t_ns,
                message.arbitration_id,
                is_extended=message.is_extended_id,
                is_remote=message.is_remote_frame,
                is_error=message.is_error_frame,
                data=bytes(message.data),
                channel=self._channel,
                sequence=self.counters.frames,
            )
        )
        self.counters.frames += 1
        self.counters.error_frames += message.is_error_frame
