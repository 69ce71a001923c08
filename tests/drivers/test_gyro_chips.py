"""The chips' scale factors and settings against their data sheets."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import DriverError
from drivers.gyro.chip_setup import possible_rate_hz
from drivers.gyro.chips import CHIPS, decode

# chip, bytes in the order of the bus, degrees per second. The source of each is the scale factor
# in the data sheet's table of electrical or angular-rate characteristics.
GOLDEN_RATES = [
    ("xv7001bb", "011800", 1.0),  # 71680 LSB/(deg/s) with 24 bit
    ("xv7001bb", "fee800", -1.0),
    ("xv7001bb", "6d6000", 100.0),  # 7168000, the end of the +-100 deg/s range
    ("xv7011bb", "004600", 1.0),  # 17920 LSB/(deg/s)
    ("xv7011bb", "ffba00", -1.0),
    ("xv7021bb", "6d6000", 400.0),  # the end of the +-400 deg/s range
    ("l3gd20h", "e02e", 105.0),  # 8.75 mdps/digit at +-245 dps: 12000 digits
    ("l3gd20h", "20d1", -105.0),
    ("itg3200", "047e", 80.0),  # 14.375 LSB/(deg/s): 1150 digits
    ("itg3200", "fb82", -80.0),
    ("mpu6050", "0083", 1.0),  # 131 LSB/(deg/s) at +-250 deg/s
    ("mpu6050", "8012", -250.0),  # -32750
]

GOLDEN_TEMPERATURES = [
    ("xv7001bb", "1900", 25.0),  # 12 bit, left-aligned: 400 LSB at 25 degrees
    ("xv7001bb", "1d00", 29.0),  # 16 LSB per degree
    ("xv7011bb", "0000", 0.0),
    ("xv7021bb", "fd80", -2.5),
    ("itg3200", "cc70", 35.0),  # -13200 LSB at 35 degrees, 280 LSB per degree
    ("itg3200", "cd88", 36.0),
    ("mpu6050", "0000", 36.53),  # raw / 340 + 36.53
    ("mpu6050", "f2b8", 26.53),
]


@pytest.mark.parametrize(("name", "data", "deg_s"), GOLDEN_RATES)
def test_bytes_of_the_data_sheet_become_rad_s(name: str, data: str, deg_s: float) -> None:
    _, rate_rad_s = decode(CHIPS[name], bytes.fromhex(data))
    assert rate_rad_s == pytest.approx(math.radians(deg_s), rel=1e-12)


def test_every_chip_has_a_golden_rate_and_temperature() -> None:
    assert {name for name, _, _ in GOLDEN_RATES} == set(CHIPS)
    with_temperature = {name for name, chip in CHIPS.items() if chip.temperature}
    assert {name for name, _, _ in GOLDEN_TEMPERATURES} == with_temperature


@pytest.mark.parametrize(("name", "data", "celsius"), GOLDEN_TEMPERATURES)
def test_bytes_of_the_data_sheet_become_celsius(name: str, data: str, celsius: float) -> None:
    temperature = CHIPS[name].temperature
    assert temperature is not None
    raw = bytes.fromhex(data)
    assert len(raw) == temperature.length
    assert temperature.celsius(raw) == pytest.approx(celsius, abs=1e-9)


@given(st.sampled_from(sorted(CHIPS)), st.binary(max_size=5))
def test_decode_scales_or_names_the_short_frame(name: str, data: bytes) -> None:
    chip = CHIPS[name]
    if len(data) != chip.data_length:
        with pytest.raises(DriverError, match=f"{len(data)} bytes .*expected {chip.data_length}"):
            decode(chip, data)
        return
    raw, rate_rad_s = decode(chip, data)
    assert raw.to_bytes(chip.data_length, chip.byte_order, signed=True) == data
    assert math.degrees(rate_rad_s) == pytest.approx(raw * chip.deg_s_per_count)


@pytest.mark.parametrize(
    ("name", "wanted_hz", "rate_hz"),
    [
        ("xv7001bb", 200.0, 200.0),
        ("l3gd20h", 200.0, 189.4),
        ("l3gd20h", 800.0, 757.6),
        ("itg3200", 200.0, 200.0),
        ("mpu6050", 330.0, 1000.0 / 3.0),
        ("mpu6050", 1000.0, 1000.0),
    ],
)
def test_the_nearest_rate_is_taken(name: str, wanted_hz: float, rate_hz: float) -> None:
    assert possible_rate_hz(CHIPS[name], wanted_hz) == pytest.approx(rate_hz)


@pytest.mark.parametrize(
    ("name", "wanted_hz", "message"),
    [
        ("l3gd20h", 250.0, "cannot do 250 Hz; the nearest rate is 189.4 Hz"),
        ("mpu6050", 700.0, "nearest rate is 1000 Hz"),
        ("xv7001bb", 2000.0, "nearest rate is 1000 Hz"),
        ("itg3200", 0.0, "expected a number above 0"),
        ("itg3200", math.nan, "expected a number above 0"),
    ],
)
def test_a_rate_that_the_chip_cannot_do_is_refused(
    name: str, wanted_hz: float, message: str
) -> None:
    with pytest.raises(DriverError, match=message):
        possible_rate_hz(CHIPS[name], wanted_hz)


@pytest.mark.parametrize(
    ("name", "rate_hz", "register", "value"),
    [
        ("xv7001bb", 200.0, 0x02, 0x04),  # 70 Hz: the highest cut-off up to 0.4 x 200 Hz
        ("xv7001bb", 10.0, 0x02, 0x00),  # 10 Hz is the lowest there is
        ("l3gd20h", 189.4, 0x20, 0x6F),  # 189.4 Hz, bandwidth 50 Hz, all axes on
        ("itg3200", 200.0, 0x15, 4),  # 1 kHz / (1 + 4)
        ("itg3200", 200.0, 0x16, 0x1B),  # +-2000 deg/s, 42 Hz
        ("mpu6050", 500.0, 0x1A, 0x01),  # 188 Hz
    ],
)
def test_settings_follow_the_rate(name: str, rate_hz: float, register: int, value: int) -> None:
    written = {step.register: step.value for step in CHIPS[name].set_up(rate_hz)}
    assert written[register] == value
