"""Yaw gyro on I2C: one driver for the chips of `gyro_chips.CHIPS`.

Every sample is two transfers: the status, then, if a sample is ready, the rate. One burst for
both would lose the samples that become ready between its first and its last byte, because
reading the rate clears the flag.

The stall bound: `read` returns or raises at most STALL_BOUND_S after its time-out, whatever the
bus does. Within it every transfer is tried `I2cLink.ATTEMPTS` times, then the bus is opened again
and the settings are checked; a chip that lost them (brown-out) is set up once more. When that
does not help in time `read` raises DriverError, and the next `read` goes on trying, so a bus
that comes back is used again.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from drivers.checks import check_positive
from drivers.errors import DriverError
from drivers.faults import Faults
from drivers.gyro.chip_setup import check_identity, describe, mismatches, possible_rate_hz, set_up
from drivers.gyro.chips import CHIPS, decode
from drivers.gyro.i2c import I2cBus, I2cLink, LinkCounters
from drivers.samples import YawRateSample
from drivers.source import SourceInfo

STALL_BOUND_S = 1.0

_ADDRESSES = range(0x08, 0x78)  # of 7 bits; I2C keeps the others for itself

_RECOVER_FOR_S = 0.5  # leaves the rest of the bound to one set-up, which takes 0.22 s at most
_RECOVER_EVERY_S = 0.02
_SILENCE_S = 0.25  # a chip without a new sample for this long is asleep or was reset
_FIRST_LOOK_PERIODS = 0.8  # after a sample was made: suits a chip that runs 20 % fast
_LOOK_EVERY_PERIODS = 0.1
_PHASE_SLACK_PERIODS = 0.2  # uncertainty of when a sample was made


@dataclass(slots=True)
class GyroCounters:
    """What was lost or mended since construction.

    Attributes:
        lost_samples: samples known to be missing; the sequence number skips them.
        overruns: times that the chip itself reported an overwritten sample.
        set_up_again: times that the chip had to be set up again.
    """

    lost_samples: int = 0
    overruns: int = 0
    set_up_again: int = 0


class YawGyro:
    """A `Source` of `YawRateSample`.

    Args:
        bus: number of /dev/i2c-N, path of a device file, or an open bus that stays the caller's.
        chip: a name of `gyro_chips.CHIPS`.
        address: 7-bit address; None for the chip's usual one.
        name: how errors and records call this gyro.
        rate_hz: samples per second; the chip's nearest rate must be within 10 %.
        temperature_period_s: how often the temperature is read.
        clock: CLOCK_MONOTONIC in nanoseconds.
        sleep: waits that many seconds.

    Raises:
        DriverError: no such chip, it cannot do the rate, or a number makes no sense.
    """

    def __init__(
        self,
        bus: int | str | I2cBus = 1,
        chip: str = "xv7001bb",
        address: int | None = None,
        *,
        name: str = "gyro",
        rate_hz: float = 200.0,
        temperature_period_s: float = 1.0,
        clock: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        if chip not in CHIPS:
            raise DriverError(f"{name}: no gyro chip {chip!r}; expected one of {', '.join(CHIPS)}")
        check_positive(f"{name}: temperature_period_s", temperature_period_s)
        if address is not None and address not in _ADDRESSES:
            raise DriverError(f"{name}: address is {address}; expected 0x08 to 0x77")
        self._chip = CHIPS[chip]
        self._name = name
        self._rate_hz = possible_rate_hz(self._chip, rate_hz)
        self._steps = self._chip.set_up(self._rate_hz)
        self._period_ns = round(1e9 / self._rate_hz)
        self._temperature_period_ns = round(temperature_period_s * 1e9)
        self._clock = clock
        self._sleep = sleep
        self._link = I2cLink(
            bus, self._chip.address if address is None else address, clock=clock, sleep=sleep
        )
        self.counters = GyroCounters()
        self._is_open = False
        self._sequence = 0
        self._temperature_c: float | None = None
        self._temperature_due_ns = 0
        self._look_ns = 0  # when to look at the chip again; of a host-paced chip the due slot
        self._made_ns: int | None = None  # when the chip made the last sample, see _advance
        self._waited = False  # the last look found no sample, so the next one will be fresh
        self._quiet_since_ns = 0
        self._silences = 0

    @property
    def name(self) -> str:
        """The instance's name."""
        return self._name

    @property
    def bus_counters(self) -> LinkCounters:
        """Failed transfers and reopened buses since construction."""
        return self._link.counters

    @property
    def faults(self) -> Faults:
        """Overwritten samples are lost; what else failed was tried again. Since construction."""
        counters, bus = self.counters, self._link.counters
        return Faults(
            {"overruns": counters.overruns},
            {
                "failed_transfers": bus.failed_transfers,
                "bus_reopened": bus.reopened,
                "set_up_again": counters.set_up_again,
            },
        )

    def open(self) -> SourceInfo:
        """Open the bus, check that it is this chip, write the settings and read them back.

        Raises:
            DriverError: nothing there, another chip, or a setting that does not hold.
        """
        self.close()
        self._link.give_up_ns = None
        try:
            self._link.open()
            check_identity(self._link, self._chip.probe)
            set_up(self._link, self._steps, self._sleep)
        except (DriverError, OSError) as error:
            self._link.close()
            raise self._error(error) from error
        self._is_open = True
        self._made_ns, self._waited, self._silences = None, False, 0
        self._temperature_c, self._temperature_due_ns = None, 0
        self._look_ns = self._quiet_since_ns = self._clock()
        return SourceInfo(
            name=self._name,
            model=self._chip.model,
            serial="",
            produces=(YawRateSample,),
            time_base="monotonic",
            details={"i2c": self._link.label, "registers": describe(self._steps)},
            nominal_rate_hz={YawRateSample: self._rate_hz},
        )

    def read(self, timeout_s: float) -> Sequence[YawRateSample]:
        """Return the next sample, or nothing when none came within `timeout_s`.

        Raises:
            DriverError: not open, or the chip could not be brought back within the stall bound.
        """
        if not self._is_open:
            raise DriverError(f"{self._name}: not open; call open() first")
        deadline_ns = self._clock() + round(timeout_s * 1e9)
        self._link.give_up_ns = deadline_ns + round(_RECOVER_FOR_S * 1e9)
        if not self._link.is_open:
            self._recover()
        while self._wait_to_look(deadline_ns):
            try:
                sample = self._look()
            except OSError:
                self._recover()
                if self._clock() >= deadline_ns:
                    break
                continue
            if sample is not None:
                return (sample,)
        return ()

    def close(self) -> None:
        """Release the bus; the chip keeps running."""
        self._is_open = False
        self._link.close()

    def _wait_to_look(self, deadline_ns: int) -> bool:
        """Sleep until the next look is due; False when the deadline comes first."""
        now_ns = self._clock()
        until_ns = min(self._look_ns, deadline_ns)
        if until_ns > now_ns:
            self._sleep((until_ns - now_ns) / 1e9)
        return self._look_ns <= deadline_ns

    def _look(self) -> YawRateSample | None:
        """Read a sample if one is ready, and decide when to look again; OSError from the bus."""
        self._read_temperature()
        status = self._link.read(self._chip.status.register, 1)[0]
        ready_ns = self._clock()
        if status & self._chip.status.ready_mask != self._chip.status.ready_value:
            self._not_ready()
            return None
        data = self._link.read(self._chip.data_register, self._chip.data_length)
        t_ns = self._clock()
        raw, rate_rad_s = decode(self._chip, data)
        self._advance(ready_ns, overrun=bool(status & self._chip.status.overrun_mask))
        return YawRateSample(t_ns, rate_rad_s, self._temperature_c, raw, self._sequence)

    def _read_temperature(self) -> None:
        """Read the temperature when it is due; before the sample, which a failure would cost."""
        temperature, now_ns = self._chip.temperature, self._clock()
        if temperature is None or now_ns < self._temperature_due_ns:
            return
        data = self._link.read(temperature.register, temperature.length)
        self._temperature_c = temperature.celsius(data)
        self._temperature_due_ns = now_ns + self._temperature_period_ns

    def _not_ready(self) -> None:
        now_ns = self._clock()
        self._waited = True
        self._look_ns = now_ns + round(_LOOK_EVERY_PERIODS * self._period_ns)
        if now_ns - self._quiet_since_ns <= _SILENCE_S * 1e9 + 2 * self._period_ns:
            return
        self._silences += 1
        if self._silences > 1:  # it was already set up again
            self._link.close()
            raise self._error("it answers but has no new samples; switch it off and on")
        raise OSError("no new sample")

    def _advance(self, ready_ns: int, *, overrun: bool) -> None:
        """Number the sample that was ready at `ready_ns`, and decide when to look again.

        `_made_ns` follows the moments at which the chip makes samples (of a host-paced chip: the
        slots); whole periods that passed since the last one are lost samples.
        """
        host_paced = self._chip.host_paced
        if self._made_ns is None:
            self._made_ns = self._look_ns if host_paced else ready_ns
            self._sequence = 0
        else:
            slack = 0.0 if host_paced else _PHASE_SLACK_PERIODS
            steps = max(1 + overrun, int((ready_ns - self._made_ns) / self._period_ns + slack))
            self._made_ns += steps * self._period_ns
            self._sequence += steps
            self.counters.lost_samples += steps - 1
            self.counters.overruns += overrun
        if not host_paced and (self._waited or self._made_ns > ready_ns):
            self._made_ns = ready_ns
        self._waited = False
        self._silences = 0
        self._quiet_since_ns = ready_ns
        wait_periods = 1.0 if host_paced else _FIRST_LOOK_PERIODS
        self._look_ns = self._made_ns + round(wait_periods * self._period_ns)

    def _recover(self) -> None:
        """Bring the chip back, or raise DriverError when the stall bound leaves no more time."""
        while True:
            try:
                self._restore()
            except (DriverError, OSError) as error:
                self._link.close()
                if self._link.give_up_ns is None or self._clock() >= self._link.give_up_ns:
                    raise self._error(error) from error
                self._sleep(_RECOVER_EVERY_S)
            else:
                return

    def _restore(self) -> None:
        """Open the bus again and set the chip up if it was silent or lost its settings."""
        self._link.reopen()
        check_identity(self._link, self._chip.probe)
        if self._silences or any(mismatches(self._link, self._steps)) or self._stopped():
            self.counters.set_up_again += 1
            set_up(self._link, self._steps, self._sleep)
        self._quiet_since_ns = self._clock()

    def _stopped(self) -> bool:
        """Tell whether a chip that is always ready while it runs is not ready."""
        if not self._chip.host_paced:
            return False
        status = self._chip.status
        return self._link.read(status.register, 1)[0] & status.ready_mask != status.ready_value

    def _error(self, reason: object) -> DriverError:
        return DriverError(f"{self._name}: {self._chip.model} at {self._link.label}: {reason}")
