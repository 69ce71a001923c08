"""A serial port as a driver wants it: exclusive, with every failure one error naming the port."""

from __future__ import annotations

import errno
import termios
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import TYPE_CHECKING, Literal

from drivers.errors import DriverError

if TYPE_CHECKING:
    import serial

_ADVICE = {
    errno.ENOENT: "plug the device in or correct the port's name",
    errno.EACCES: "add the user to the group that owns the port (dialout)",
    errno.EAGAIN: "stop the other program that has the port open",
    errno.EBUSY: "stop the other program that has the port open",
}


class SerialLink:
    """One open serial port; made by `open_serial`."""

    def __init__(self, name: str, port: serial.Serial) -> None:
        self._name = name
        self._port = port

    def read(self, timeout_s: float) -> bytes:
        """Return the bytes that are there, or the first to come; empty when none came in time.

        Raises:
            DriverError: the device is gone.
        """
        with _failures(self._name, "reading"):
            # Setting the timeout reconfigures the port, hence only when it changes.
            if self._port.timeout != timeout_s:
                self._port.timeout = timeout_s
            data = self._port.read(max(1, self._port.in_waiting))
            if data and (more := self._port.in_waiting):
                data += self._port.read(more)
            return bytes(data)

    def write(self, data: bytes) -> None:
        """Send bytes.

        Raises:
            DriverError: the device is gone.
        """
        with _failures(self._name, "writing"):
            self._port.write(data)

    def discard_input(self) -> None:
        """Throw away what has arrived and was not read.

        Raises:
            DriverError: the device is gone.
        """
        with _failures(self._name, "reading"):
            self._port.reset_input_buffer()

    def set_baud(self, baud: int) -> None:
        """Send what is still to be sent, then change the speed.

        Raises:
            DriverError: the port refuses it, or the device is gone.
        """
        with _failures(self._name, f"setting {baud} baud"):
            self._port.flush()
            self._port.baudrate = baud

    def close(self) -> None:
        """Give the port back; harmless when the device is gone."""
        self._port.close()


def open_serial(
    port: str,
    *,
    label: str | None = None,
    baud: int,
    data_bits: Literal[7, 8] = 8,
    parity: Literal["none", "even", "odd"] = "none",
    stop_bits: Literal[1, 2] = 1,
) -> SerialLink:
    """Open a port for this program alone; errors call it by its label, or else by its path.

    Raises:
        DriverError: pyserial is missing, or the port is absent, busy or refuses the settings.
    """
    serial = _pyserial()
    name = port if label is None else label
    with _failures(name, "opening"):
        opened = serial.Serial(
            port,
            baud,
            bytesize=data_bits,
            parity={"none": "N", "even": "E", "odd": "O"}[parity],
            stopbits=stop_bits,
            timeout=0.0,
            write_timeout=1.0,
            exclusive=True,
        )
    return SerialLink(name, opened)


def _pyserial() -> ModuleType:
    try:
        import serial
    except ImportError as error:
        raise DriverError(
            "the library pyserial is not installed; "
            "a serial device needs it: pip install 'terravibe[vibration]'"
        ) from error
    return serial


@contextmanager
def _failures(name: str, doing: str) -> Iterator[None]:
    """Turn every way in which a serial port fails into a DriverError.

    pyserial's SerialException is an OSError; an unplugged port also raises plain OSError (EIO)
    and termios.error, and ValueError stands for a setting that it does not know.
    """
    try:
        yield
    except (OSError, termios.error, ValueError) as error:
        number = error.args[0] if error.args and isinstance(error.args[0], int) else None
        advice = _ADVICE.get(number or 0, "check the cable, reconnect and open it again")
        raise DriverError(
            f"{name}: {doing} failed ({error}); expected a connected serial device; {advice}"
        ) from error
