"""Register models of the gyro chips, written from their data sheets and not from the driver.

Every sample of a free-running chip is numbered, and its raw value is its number (modulo 2^15), so
that a test sees exactly which samples were lost.

Not simulated: turn rates and noise, FIFOs, interrupt pins, self-test, filters, and registers that
the data sheets leave undocumented (they read 0 and swallow writes).
"""

from __future__ import annotations

from typing import ClassVar

from tests.fakes.fake_time import FakeTime


class RegisterChip:
    """Registers with a pointer that moves on after every byte."""

    RESET_S = 0.0
    DEFAULTS: ClassVar[dict[int, int]] = {}

    def __init__(self, time: FakeTime, *, clock_error: float = 0.0) -> None:
        self.time = time
        self.clock_error = clock_error
        self.stuck_registers: dict[int, int] = {}
        self.halted = False  # answers on the bus, takes no samples
        self.power_cycle()

    def power_cycle(self) -> None:
        """Lose everything, as after a brown-out."""
        self.registers = bytearray(128)
        for register, value in self.DEFAULTS.items():
            self.registers[register] = value
        self._pointer = 0
        self._busy_until_ns = self.time.now_ns
        self._started_ns: int | None = None
        self._rate_hz = 0.0
        self._seen = 0

    def acknowledges(self) -> bool:
        return self.time.now_ns >= self._busy_until_ns

    def write(self, data: bytes) -> None:
        self._pointer = data[0]
        for value in data[1:]:
            self._write_register(self._pointer & 0x7F, value)
            self._step()

    def read(self, length: int) -> bytes:
        data = bytearray()
        for _ in range(length):
            data.append(self._read_register(self._pointer & 0x7F))
            self._step()
        return bytes(data)

    def _step(self) -> None:
        self._pointer += 1

    def _write_register(self, register: int, value: int) -> None:
        self.registers[register] = self.stuck_registers.get(register, value)

    def _read_register(self, register: int) -> int:
        return self.registers[register]

    def reset(self) -> None:
        self.power_cycle()
        self._busy_until_ns = self.time.now_ns + round(self.RESET_S * 1e9)

    # --- free-running samples -------------------------------------------------------------------

    def _run_at(self, rate_hz: float) -> None:
        if rate_hz != self._rate_hz:
            self._rate_hz = rate_hz
            self._started_ns = self.time.now_ns if rate_hz else None
            self._seen = 0

    @property
    def produced(self) -> int:
        """How many samples the chip has taken since it was started."""
        if self._started_ns is None or self.halted:
            return self._seen
        elapsed_s = (self.time.now_ns - self._started_ns) / 1e9
        return int(elapsed_s * self._rate_hz * (1.0 + self.clock_error))

    def _sample(self) -> int:
        return self.produced & 0x7FFF


class L3gd20h(RegisterChip):
    """ST L3GD20H. The pointer moves only when the register was addressed with its top bit set."""

    DEFAULTS: ClassVar = {0x0F: 0xD7, 0x20: 0x07}
    RATES_HZ = (94.7, 189.4, 378.8, 757.6)

    def _step(self) -> None:
        if self._pointer & 0x80:
            self._pointer += 1

    def _write_register(self, register: int, value: int) -> None:
        super()._write_register(register, value)
        control = self.registers[0x20]
        self._run_at(self.RATES_HZ[control >> 6] if control & 0x08 else 0.0)

    def _read_register(self, register: int) -> int:
        if register == 0x27:
            unread = self.produced - self._seen
            return (0x04 if unread >= 1 else 0) | (0x40 if unread >= 2 else 0)
        if register == 0x2C:
            self._latched = self._sample()  # block data update: both bytes of one sample
            return self._latched & 0xFF
        if register == 0x2D:
            self._seen = self.produced
            return self._latched >> 8
        return super()._read_register(register)


class _InvenSense(RegisterChip):
    """What ITG-3200 and MPU-6050 share; the addresses differ."""

    POWER = DIVIDER = LOW_PASS = ENABLE = STATUS = DATA = TEMPERATURE = 0
    TEMPERATURE_RAW = 0

    def _write_register(self, register: int, value: int) -> None:
        if register == self.POWER and value & 0x80:
            self.reset()
            return
        super()._write_register(register, value)
        awake = not self.registers[self.POWER] & 0x40
        base_hz = 1000.0 if 1 <= self.registers[self.LOW_PASS] & 0x07 <= 6 else 8000.0
        self._run_at(base_hz / (1 + self.registers[self.DIVIDER]) if awake else 0.0)

    def _read_register(self, register: int) -> int:
        if register == self.STATUS:
            ready = self.registers[self.ENABLE] & 0x01 and self.produced > self._seen
            self._seen = self.produced
            return 0x01 if ready else 0x00
        if register == self.DATA:
            self._latched = self._sample()
            return self._latched >> 8
        if register == self.DATA + 1:
            return self._latched & 0xFF
        if register in (self.TEMPERATURE, self.TEMPERATURE + 1):
            raw = self.TEMPERATURE_RAW.to_bytes(2, "big", signed=True)
            return raw[register - self.TEMPERATURE]
        return super()._read_register(register)


class Itg3200(_InvenSense):
    """InvenSense ITG-3200 at 35 degrees."""

    DEFAULTS: ClassVar = {0x00: 0x68}
    RESET_S = 0.010
    POWER, DIVIDER, LOW_PASS, ENABLE, STATUS = 0x3E, 0x15, 0x16, 0x17, 0x1A
    DATA, TEMPERATURE, TEMPERATURE_RAW = 0x21, 0x1B, -13200


class Mpu6050(_InvenSense):
    """InvenSense MPU-6050, asleep at power-on, at 36.53 degrees."""

    DEFAULTS: ClassVar = {0x75: 0x68, 0x6B: 0x40}
    RESET_S = 0.100
    POWER, DIVIDER, LOW_PASS, ENABLE, STATUS = 0x6B, 0x19, 0x1A, 0x38, 0x3A
    DATA, TEMPERATURE, TEMPERATURE_RAW = 0x47, 0x41, 0


class EpsonXv(RegisterChip):
    """Epson XV70x1BB at 25 degrees. Its rate output is the time since power-on in 0.1 ms."""

    DEFAULTS: ClassVar = {0x1C: 0x0B}
    RESET_S = 0.001
    START_UP_S = 0.200
    POWER_ON, STANDBY, SLEEP, RUNNING = 4, 2, 0, 1
    STATES: ClassVar = {0x05: SLEEP, 0x06: RUNNING, 0x07: STANDBY}
    TEMPERATURE_RAW = 400 << 4

    def power_cycle(self) -> None:
        super().power_cycle()
        self.state = self.POWER_ON
        self.zeroed = False
        self._since_ns = self.time.now_ns
        self._i2c_off = False

    def acknowledges(self) -> bool:
        return super().acknowledges() and not self._i2c_off

    def write(self, data: bytes) -> None:
        super().write(data)
        if len(data) == 1:
            self._command(data[0])

    def _command(self, register: int) -> None:
        if register == 0x09:
            self.reset()
        elif register in self.STATES:
            self.state = self.STATES[register]
            self._since_ns = self.time.now_ns
        elif register == 0x0C:
            self.zeroed = True  # AutoC moves the zero point: only legal at standstill

    def _write_register(self, register: int, value: int) -> None:
        super()._write_register(register, value)
        self._i2c_off = register == 0x1F  # IfCtl switches the interface to SPI

    def read(self, length: int) -> bytes:
        register = self._pointer & 0x7F
        if register == 0x04:
            return bytes([self.state | 0x08])
        if register == 0x08:
            return self.TEMPERATURE_RAW.to_bytes(2, "big", signed=True)[:length]
        if register == 0x0A:
            return self._rate()[:length].ljust(length, b"\0")
        return super().read(length)

    def _rate(self) -> bytes:
        if not self.registers[0x0B] & 0x01 or not self._has_started():
            return bytes(3)
        tenths_ms = self.time.now_ns // 100_000
        if self.registers[0x0B] & 0x04:
            return (tenths_ms % 2**23).to_bytes(3, "big")
        return (tenths_ms % 2**15).to_bytes(2, "big")

    def _has_started(self) -> bool:
        running_s = (self.time.now_ns - self._since_ns) / 1e9
        return self.state == self.RUNNING and running_s >= self.START_UP_S


MODELS: dict[str, type[RegisterChip]] = {
    "xv7001bb": EpsonXv,
    "xv7011bb": EpsonXv,
    "xv7021bb": EpsonXv,
    "l3gd20h": L3gd20h,
    "itg3200": Itg3200,
    "mpu6050": Mpu6050,
}
