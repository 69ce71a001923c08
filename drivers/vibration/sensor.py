"""Triaxial vibration sensors on a serial port: AFT601D and kin, described by profile files.

The frame layout is not in this code but in `drivers/vibration/profiles/*.toml`; see
`drivers.vibration.profile_tables` for what a profile may say and docs/devices/vibration.md for
how to choose one, adapt it and check it.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from drivers.errors import DriverError
from drivers.faults import NO_FAULTS, Faults
from drivers.samples import AccelerationSample, Sample, VibrationSample
from drivers.source import SourceInfo, TickCounter
from drivers.vibration.profile import load_profile
from drivers.vibration.profile_tables import VibrationProfile
from drivers.vibration.serial_link import open_serial
from drivers.vibration.session import VibrationSession, VibrationStatistics


class VibrationSensor:
    """A vibration sensor on a serial port, as a `Source`.

    Args:
        port: device path, such as /dev/serial/by-id/...
        profile: name of a shipped profile, or the path of a profile file.
        name: the instance's name.
        clock_ns: the monotonic clock, ns; a batch of bytes is stamped right after its read.
        sleep: waits for that many seconds, between the requests to a polled device.
    """

    def __init__(
        self,
        port: str,
        profile: str | Path = "aft601d",
        *,
        name: str = "vibration",
        clock_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._port = port
        self._label = f"{name} ({port})"
        self._profile = profile
        self._name = name
        self._clock_ns = clock_ns
        self._sleep = sleep
        self._session: VibrationSession | None = None

    @property
    def name(self) -> str:
        """The instance's name."""
        return self._name

    @property
    def statistics(self) -> VibrationStatistics:
        """The counters since `open`; zeros while closed."""
        return self._session.statistics if self._session else VibrationStatistics()

    @property
    def faults(self) -> Faults:
        """Bytes, frames and requests that gave no sample, since `open`; none while closed."""
        return self._session.statistics.faults() if self._session else NO_FAULTS

    def open(self) -> SourceInfo:
        """Open the port for this program alone, start the device and wait for a frame from it.

        A stream that already runs is not disturbed: the profile's start steps are sent only to a
        device that is silent. A polled device gets them always.

        Raises:
            DriverError: bad profile; port absent or busy; no frame of this profile in time.
        """
        self.close()
        profile = load_profile(self._profile)
        session = self._connect(profile)
        try:
            replies = session.start()
        except BaseException:
            session.close()
            raise
        self._session = session
        return self._describe(profile, replies)

    def probe(self) -> bool:
        """Tell whether frames of this profile come from the port, then close it.

        Listens, or polls, for the profile's `identify_within_s`; sends no start steps, so it
        never changes the device.

        Raises:
            DriverError: bad profile; port absent or busy.
        """
        self.close()
        session = self._connect(load_profile(self._profile))
        try:
            return session.hears_frame()
        except DriverError:  # no answer to the requests, or gone
            return False
        finally:
            session.close()

    def read(self, timeout_s: float) -> Sequence[Sample]:
        """Return the samples of the next frames, waiting at most `timeout_s` seconds.

        Raises:
            DriverError: not open; unplugged; a polled device did not answer repeated requests.
        """
        if self._session is None:
            raise DriverError(f"{self._label} is not open; call open() before read()")
        return self._session.read(timeout_s)

    def close(self) -> None:
        """Send the profile's stop steps, as far as the device still listens, and free the port."""
        session, self._session = self._session, None
        if session is not None:
            with contextlib.suppress(DriverError):  # an unplugged device cannot be stopped
                session.stop()
            session.close()

    def _connect(self, profile: VibrationProfile) -> VibrationSession:
        settings = profile.serial
        link = open_serial(
            self._port,
            label=self._label,
            baud=settings.baud,
            data_bits=settings.data_bits,
            parity=settings.parity,
            stop_bits=settings.stop_bits,
        )
        return VibrationSession(self._label, link, profile, self._clock_ns, self._sleep)

    def _describe(self, profile: VibrationProfile, replies: Mapping[str, str]) -> SourceInfo:
        identity, clock, band = profile.profile, profile.clock, profile.sample.band_hz
        details = {
            "port": self._port,
            "profile": identity.name,
            "layout": "verified" if identity.verified else "assumed, not verified",
            "layout source": identity.source,
            **replies,
        }
        if band is not None:
            details["band Hz"] = f"{band[0]:g} to {band[1]:g}"
        if clock is not None:
            details["device clock"] = f"{clock.tick_s:g} s, wraps at {clock.wrap_ticks} ticks"
        produces: tuple[type[Sample], ...] = (VibrationSample,)
        if profile.sample.specific_force is not None:
            produces = (VibrationSample, AccelerationSample)
        return SourceInfo(
            name=self._name,
            model=identity.device,
            serial="",  # none of the known protocols tells one
            produces=produces,
            time_base="monotonic",
            details=details,
            nominal_rate_hz=dict.fromkeys(produces, profile.link.nominal_rate_hz),
            counter=TickCounter(1.0 / clock.tick_s, clock.wrap_ticks) if clock else None,
        )


def probe_port(port: str, profiles: Sequence[str | Path]) -> dict[str, bool]:
    """Tell for each profile whether its frames come from the port.

    Nothing is sent but the requests of polled profiles. Takes up to the sum of the profiles'
    `identify_within_s`.

    Raises:
        DriverError: a profile is bad; the port is absent or busy.
    """
    return {str(profile): VibrationSensor(port, profile).probe() for profile in profiles}
