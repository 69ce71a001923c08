"""What happens on the port between `open` and `close` of a vibration sensor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field

from drivers.errors import DriverError
from drivers.faults import Faults
from drivers.samples import Sample
from drivers.vibration.decode import FrameDecoder
from drivers.vibration.frames import Frame, FrameCounters, FrameParser
from drivers.vibration.poll import PollCounters, Poller
from drivers.vibration.profile_tables import Step, VibrationProfile
from drivers.vibration.serial_link import SerialLink
from drivers.vibration.stamps import ArrivalTimes


@dataclass(frozen=True, slots=True)
class VibrationStatistics:
    """What has been met since `open`: in the byte stream, and in the polling if there is any."""

    frames: FrameCounters = field(default_factory=FrameCounters)
    polls: PollCounters = field(default_factory=PollCounters)

    def faults(self) -> Faults:
        """Return what was lost; a stream that is not polled has no faults of polling."""
        lost = asdict(self.frames)
        del lost["frames"]
        polls = asdict(self.polls)
        if polls.pop("requests"):
            lost |= {f"polls_{name}": count for name, count in polls.items()}
        return Faults(lost)


class VibrationSession:
    """Speaks with the device behind an open port as its profile says."""

    def __init__(
        self,
        port: str,
        link: SerialLink,
        profile: VibrationProfile,
        clock_ns: Callable[[], int],
        sleep: Callable[[float], None],
    ) -> None:
        self._port, self._link, self._profile = port, link, profile
        self._clock_ns, self._sleep = clock_ns, sleep
        self._parser = FrameParser(profile)
        self._decoder = FrameDecoder(profile)
        period_ns = round(1e9 / profile.link.nominal_rate_hz)
        poll = profile.poll
        self._poller = Poller(port, poll, period_ns, clock_ns, sleep) if poll else None
        self._arrivals = ArrivalTimes(profile.serial.byte_ns(), None if poll else period_ns)
        self._sequence = 0

    @property
    def statistics(self) -> VibrationStatistics:
        """The counters so far."""
        polls = self._poller.counters if self._poller else PollCounters()
        return VibrationStatistics(self._parser.counters, polls)

    def start(self) -> dict[str, str]:
        """Make the device send frames and wait for one; return the replies to the start steps.

        A device that streams already gets no start steps.

        Raises:
            DriverError: no or another reply, no frame in time, or the device is gone.
        """
        if self._poller is None and self._profile.start and self.hears_frame():
            return {}
        replies = {step.what: self._take(step).hex(" ") for step in self._profile.start}
        if not self.hears_frame():
            raise DriverError(
                f"{self._port}: {self._heard()} and no frame in "
                f"{self._profile.link.identify_within_s} s; expected frames of profile "
                f"{self._profile.profile.name!r}; check wiring, power and the speed of "
                f"{self._profile.serial.baud} baud, or adapt the profile"
            )
        return replies

    def stop(self) -> None:
        """Send the stop steps.

        Raises:
            DriverError: no or another reply, or the device is gone.
        """
        for step in self._profile.stop:
            self._take(step)

    def close(self) -> None:
        """Free the port."""
        self._link.close()

    def hears_frame(self) -> bool:
        """Wait the profile's `identify_within_s` for a frame, which is not kept.

        Raises:
            DriverError: the device is gone, or does not answer repeated requests.
        """
        heard = bool(self.read(self._profile.link.identify_within_s))
        self._sequence = 0
        return heard

    def read(self, timeout_s: float) -> list[Sample]:
        """Return the samples of the next frames, waiting at most `timeout_s` seconds.

        Raises:
            DriverError: the device is gone, or does not answer repeated requests.
        """
        deadline_ns = self._clock_ns() + round(timeout_s * 1e9)
        while True:
            if self._poller is not None:
                wait_s = self._poller.ask(self._link, deadline_ns)
            else:
                wait_s = max(0, deadline_ns - self._clock_ns()) / 1e9
            data = self._link.read(wait_s)
            samples = self._samples(self._frames(data, self._clock_ns()))
            if self._poller is not None:
                self._poller.hear(data, answered=bool(samples))
            if samples or self._clock_ns() >= deadline_ns:
                return samples

    def _frames(self, data: bytes, t_ns: int) -> list[Frame]:
        """Return the frames that are certain with `data`, which was read at `t_ns`."""
        if data:
            self._arrivals.note(len(data), t_ns)
        frames = self._parser.feed(data)
        if not frames and self._poller is not None and self._poller.overdue:
            return self._parser.end_burst()
        return frames

    def _samples(self, frames: list[Frame]) -> list[Sample]:
        samples: list[Sample] = []
        for frame in frames:
            stamp_ns = self._arrivals.stamp(frame.end, len(frame.data))
            values = self._decoder.decode(frame.data)
            samples += self._decoder.samples(values, stamp_ns, self._sequence)
            self._sequence += 1
        self._arrivals.forget_before(self._parser.position)
        return samples

    def _take(self, step: Step) -> bytes:
        """Send the bytes of a step and return the reply that the profile expects."""
        if step.baud is not None:
            self._link.set_baud(step.baud)
        self._link.discard_input()
        self._link.write(step.send)
        reply = self._reply(step) if step.reply_length else b""
        if step.baud is not None:
            # An adapter may still hold the bytes when the system believes them sent.
            self._sleep(len(step.send) * self._profile.serial.byte_ns(step.baud) / 1e9)
            self._link.set_baud(self._profile.serial.baud)
        return reply

    def _reply(self, step: Step) -> bytes:
        deadline_ns = self._clock_ns() + round(step.reply_within_s * 1e9)
        received = b""
        while (left_ns := deadline_ns - self._clock_ns()) > 0:
            received += self._link.read(left_ns / 1e9)
            # Garbage may come first, and some RS-485 adapters echo what was sent.
            start = received.find(step.reply)
            if 0 <= start <= len(received) - step.reply_length:
                return received[start : start + step.reply_length]
        raise DriverError(
            f"{self._port}: {step.what}: {received.hex(' ') or 'nothing'} came in "
            f"{step.reply_within_s} s; expected {step.reply_length} bytes beginning with "
            f"{step.reply.hex(' ')}; check wiring, power, speed and the device's address"
        )

    def _heard(self) -> str:
        counters = self._parser.counters
        total = counters.garbage_bytes + self._parser.pending_bytes
        wrong = counters.checksum_errors
        with_sync = f", {wrong} times the sync with a wrong checksum," if wrong else ""
        return f"{total} bytes{with_sync}" if total else "silence"
