"""The gyro chips that `YawGyro` knows: registers and scale factors, as data.

Register addresses, bit meanings and scale factors are from the makers' data sheets: Seiko Epson
XV7001BB, XV7011BB and XV7021BB (one sensing axis); STMicroelectronics L3GD20H, InvenSense
ITG-3200 (PS-ITG-3200A) and MPU-6050 (RM-MPU-6000A), of which only the Z axis is used.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from drivers.errors import DriverError

# A low-pass at 0.4 of the output rate keeps most of a vibration above the Nyquist frequency out.
_CUTOFF_PER_RATE = 0.4


@dataclass(frozen=True, slots=True)
class Step:
    """One write during set-up.

    Attributes:
        register: the address.
        value: what to write; None sends the address alone, which is a command.
        settle_s: how long the chip needs afterwards.
        check_mask: the bits that must read back as written; 0 where reading back is meaningless.
    """

    register: int
    value: int | None = None
    settle_s: float = 0.0
    check_mask: int = 0xFF


@dataclass(frozen=True, slots=True)
class Probe:
    """A register that tells whether this can be the chip: one of `allowed` under `mask`."""

    register: int
    mask: int
    allowed: tuple[int, ...]
    meaning: str


@dataclass(frozen=True, slots=True)
class Status:
    """A register that tells whether a sample can be read, and whether one was lost."""

    register: int
    ready_mask: int
    ready_value: int
    overrun_mask: int = 0


@dataclass(frozen=True, slots=True)
class Temperature:
    """Where the chip's temperature is and how its bytes become degrees Celsius."""

    register: int
    length: int
    celsius: Callable[[bytes], float]


@dataclass(frozen=True, slots=True)
class GyroChip:
    """Everything that differs between the chips.

    Attributes:
        model: maker and part.
        address: 7-bit I2C address as most boards strap it.
        probe: identity register, or a state register where there is no identity.
        output_rate_hz: the rate that the chip can do nearest to the one asked for.
        set_up: the writes, in order, for one of those rates.
        status: readiness.
        data_register: first byte of the rate.
        data_length: its number of bytes.
        byte_order: of the rate, which is two's complement.
        deg_s_per_count: scale factor of the data sheet.
        host_paced: the chip has no data-ready flag; the host's clock decides when to read.
        temperature: None where the chip reports no absolute temperature.
    """

    model: str
    address: int
    probe: Probe
    output_rate_hz: Callable[[float], float]
    set_up: Callable[[float], tuple[Step, ...]]
    status: Status
    data_register: int
    data_length: int
    byte_order: Literal["big", "little"]
    deg_s_per_count: float
    host_paced: bool = False
    temperature: Temperature | None = None


def decode(chip: GyroChip, data: bytes) -> tuple[int, float]:
    """Return (raw counts, rate in rad/s) of the bytes read from `chip.data_register`.

    Raises:
        DriverError: not as many bytes as the chip sends.
    """
    if len(data) != chip.data_length:
        raise DriverError(
            f"{chip.model}: {len(data)} bytes of angular rate, expected {chip.data_length}; "
            "the bus returned a short frame"
        )
    raw = int.from_bytes(data, chip.byte_order, signed=True)
    return raw, math.radians(raw * chip.deg_s_per_count)


# --- Seiko Epson XV70x1BB -----------------------------------------------------------------------

# DspCtl2, LpfFc: cut-off in Hz -> code.
_EPSON_LOW_PASS_HZ = (10, 35, 45, 50, 70, 85, 100, 140, 175, 200, 285, 345, 400, 500)
_EPSON_MAX_HZ = 1000.0


def _epson_set_up(rate_hz: float) -> tuple[Step, ...]:
    return (
        Step(0x09, settle_s=0.010),  # SWRst: back to the default settings
        Step(0x06),  # SlpOut
        Step(0x0B, 0x05, check_mask=0x05),  # OutCtl1: output on, 24 bit
        Step(0x02, _low_pass_code(_EPSON_LOW_PASS_HZ, rate_hz), check_mask=0x3F),  # 2nd order
        Step(0x1C, 0x4B, check_mask=0x60),  # TsDataFormat: 12 bit; low bits are fixed
        Step(0x0D, settle_s=0.200),  # DspRes, then the start-up time tSTA
    )


def _epson_celsius(data: bytes) -> float:
    """12 bit, left-aligned: 400 counts at 25 degrees, 16 counts per degree."""
    return 25.0 + ((int.from_bytes(data, "big", signed=True) >> 4) - 400) / 16.0


def _epson(model: str, counts_per_deg_s: float) -> GyroChip:
    return GyroChip(
        model=f"Epson {model}",
        address=0x6A,
        # There is no identity register. StsRd: 4 power-on, 2 standby, 0 asleep, 1 running.
        probe=Probe(0x04, 0x07, (0, 1, 2, 4), "state"),
        output_rate_hz=lambda rate_hz: min(rate_hz, _EPSON_MAX_HZ),
        set_up=_epson_set_up,
        status=Status(0x04, ready_mask=0x07, ready_value=0x01),
        data_register=0x0A,
        data_length=3,
        byte_order="big",
        deg_s_per_count=1.0 / counts_per_deg_s,
        host_paced=True,
        temperature=Temperature(0x08, 2, _epson_celsius),
    )


# --- STMicroelectronics L3GD20H -----------------------------------------------------------------

_L3GD20H_RATES_HZ = (94.7, 189.4, 378.8, 757.6)  # CTRL1 DR, with Low_ODR = 0
_AUTO_INCREMENT = 0x80


def _l3gd20h_set_up(rate_hz: float) -> tuple[Step, ...]:
    data_rate = _L3GD20H_RATES_HZ.index(rate_hz)
    return (
        Step(0x39, 0x00),  # LOW_ODR: normal rates, I2C on
        Step(0x21, 0x00),  # CTRL2: high-pass at its reset value
        Step(0x23, 0x80),  # CTRL4: no half-updated samples (BDU), +-245 deg/s, little-endian
        Step(0x24, 0x02),  # CTRL5: output after LPF2, no FIFO, no high-pass (it would eat the rate)
        Step(0x2E, 0x00),  # FIFO_CTRL: bypass
        Step(0x20, data_rate << 6 | 0x2F, settle_s=0.100),  # CTRL1: BW = 2 (50 Hz), axes on
    )


def _l3gd20h() -> GyroChip:
    return GyroChip(
        model="ST L3GD20H (Z axis)",
        address=0x6B,
        probe=Probe(0x0F, 0xFF, (0xD7,), "WHO_AM_I"),
        output_rate_hz=lambda rate_hz: _nearest(_L3GD20H_RATES_HZ, rate_hz),
        set_up=_l3gd20h_set_up,
        status=Status(0x27, ready_mask=0x04, ready_value=0x04, overrun_mask=0x40),
        data_register=0x2C | _AUTO_INCREMENT,
        data_length=2,
        byte_order="little",
        deg_s_per_count=0.00875,
        # OUT_TEMP gives -1 count per degree from an offset that the data sheet does not state.
        temperature=None,
    )


# --- InvenSense ITG-3200 and MPU-6050 -----------------------------------------------------------

# DLPF_CFG 1..6; with 0 the chips sample at 8 kHz, which the divider below does not assume.
_INVENSENSE_LOW_PASS_HZ = (5, 10, 20, 42, 98, 188)
_INVENSENSE_BASE_HZ = 1000.0


def _invensense_rate_hz(rate_hz: float) -> float:
    return _INVENSENSE_BASE_HZ / (_divider(rate_hz) + 1)


def _divider(rate_hz: float) -> int:
    """SMPLRT_DIV: output rate = 1 kHz / (1 + divider)."""
    return min(max(round(_INVENSENSE_BASE_HZ / rate_hz) - 1, 0), 255)


def _invensense_low_pass(rate_hz: float) -> int:
    """DLPF_CFG: 6 is the lowest cut-off, 1 the highest."""
    return 6 - _low_pass_code(_INVENSENSE_LOW_PASS_HZ, rate_hz)


def _itg3200_set_up(rate_hz: float) -> tuple[Step, ...]:
    return (
        Step(0x3E, 0x80, settle_s=0.050, check_mask=0),  # PWR_MGM: reset, clears itself
        Step(0x3E, 0x03, settle_s=0.070),  # PWR_MGM: awake, clock from the Z gyro
        Step(0x15, _divider(rate_hz)),  # SMPLRT_DIV
        Step(0x16, 0x18 | _invensense_low_pass(rate_hz)),  # DLPF_FS: +-2000 deg/s, low-pass
        Step(0x17, 0x21),  # INT_CFG: data-ready flag, held until the status is read
    )


def _mpu6050_set_up(rate_hz: float) -> tuple[Step, ...]:
    return (
        Step(0x6B, 0x80, settle_s=0.100, check_mask=0),  # PWR_MGMT_1: reset, clears itself
        Step(0x6B, 0x03, settle_s=0.030),  # PWR_MGMT_1: awake, clock from the Z gyro
        Step(0x19, _divider(rate_hz)),  # SMPLRT_DIV
        Step(0x1A, _invensense_low_pass(rate_hz)),  # CONFIG
        Step(0x1B, 0x00),  # GYRO_CONFIG: +-250 deg/s
        Step(0x37, 0x20),  # INT_PIN_CFG: flag held until the status is read
        Step(0x38, 0x01),  # INT_ENABLE: data-ready
    )


def _itg3200() -> GyroChip:
    return GyroChip(
        model="InvenSense ITG-3200 (Z axis)",
        address=0x68,
        probe=Probe(0x00, 0x7E, (0x68,), "WHO_AM_I"),
        output_rate_hz=_invensense_rate_hz,
        set_up=_itg3200_set_up,
        status=Status(0x1A, ready_mask=0x01, ready_value=0x01),
        data_register=0x21,
        data_length=2,
        byte_order="big",
        deg_s_per_count=1.0 / 14.375,
        temperature=Temperature(
            0x1B, 2, lambda data: 35.0 + (int.from_bytes(data, "big", signed=True) + 13200) / 280.0
        ),
    )


def _mpu6050() -> GyroChip:
    return GyroChip(
        model="InvenSense MPU-6050 (Z axis)",
        address=0x68,
        probe=Probe(0x75, 0x7E, (0x68,), "WHO_AM_I"),
        output_rate_hz=_invensense_rate_hz,
        set_up=_mpu6050_set_up,
        status=Status(0x3A, ready_mask=0x01, ready_value=0x01),
        data_register=0x47,
        data_length=2,
        byte_order="big",
        deg_s_per_count=1.0 / 131.0,
        temperature=Temperature(
            0x41, 2, lambda data: int.from_bytes(data, "big", signed=True) / 340.0 + 36.53
        ),
    )


def _low_pass_code(cutoffs_hz: tuple[int, ...], rate_hz: float) -> int:
    """Return the index of the highest cut-off that suits the rate, else of the lowest."""
    suitable = [i for i, cutoff in enumerate(cutoffs_hz) if cutoff <= _CUTOFF_PER_RATE * rate_hz]
    return suitable[-1] if suitable else 0


def _nearest(rates_hz: tuple[float, ...], wanted_hz: float) -> float:
    return min(rates_hz, key=lambda rate: abs(rate - wanted_hz))


CHIPS: Mapping[str, GyroChip] = {
    "xv7001bb": _epson("XV7001BB", 71680.0),
    "xv7011bb": _epson("XV7011BB", 17920.0),
    "xv7021bb": _epson("XV7021BB", 17920.0),
    "l3gd20h": _l3gd20h(),
    "itg3200": _itg3200(),
    "mpu6050": _mpu6050(),
}
