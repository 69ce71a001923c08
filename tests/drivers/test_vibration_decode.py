"""From frame bytes to SI numbers: captured and published frames, invalid codes, fuzz."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import DriverError
from drivers.samples import AccelerationSample, VibrationSample
from drivers.vibration.decode import FrameDecoder
from drivers.vibration.profile import load_profile, shipped_profiles
from drivers.vibration.profile_tables import VibrationProfile
from tests.fakes.vibration_bytes import frame_of

# Bytes that a WTVB02-485 at rest sent, from a public log of a serial port, 2024-10-11.
CAPTURED_REPLY = bytes.fromhex(
    "50 03 2E 0A 18 0E 09 2A 15 03 CE F9 18 02 8D 03 1C 00 00 00 00 00 00 00 00 00"
    "00 00 00 00 00 00 00 00 00 08 30 00 00 00 00 00 00 00 00 00 00 00 00 96 76"
)
# The example of the WTVB01-BT50 manual, section 5.2.
MANUAL_FRAME = bytes.fromhex(
    "55 61 11 00 16 00 02 00 02 00 00 00 01 00 E6 0A 43 00 47 00 0A 00 25 00 25 00 25 00"
)


def _changed(profile: VibrationProfile, **sample: object) -> VibrationProfile:
    return profile.model_copy(update={"sample": profile.sample.model_copy(update=sample)})


def test_the_captured_reply() -> None:
    values = FrameDecoder(load_profile("wtvb01-485")).decode(CAPTURED_REPLY)
    # Registers -1768, 653, 796 of 16 g / 32768: at rest they make up 1 g.
    assert values.fields["acceleration"] == pytest.approx(
        np.array([-1768, 653, 796]) * 16 * 9.80665 / 32768
    )
    assert np.linalg.norm(values.fields["acceleration"]) == pytest.approx(9.80665, rel=0.01)
    assert values.fields["temperature"] == (20.96,)
    assert values.fields["displacement"] == values.fields["frequency"] == (0.0, 0.0, 0.0)
    # 14 h 21 min 42.974 s by the device's clock
    assert values.device_ticks == ((14 * 60 + 21) * 60 + 42) * 1000 + 974


def test_the_example_of_the_manual() -> None:
    values = FrameDecoder(load_profile("wtvb01-bt50")).decode(MANUAL_FRAME)
    assert values.fields["velocity"] == pytest.approx((17e-3, 22e-3, 2e-3))
    count_rad = math.pi / 32768
    assert values.fields["angle"] == pytest.approx((2 * count_rad, 0, count_rad))
    assert values.fields["temperature"] == pytest.approx((27.90,))
    assert values.fields["displacement"] == pytest.approx((67e-6, 71e-6, 10e-6))
    assert values.fields["frequency"] == (37.0, 37.0, 37.0)
    assert values.device_ticks is None


def test_the_high_speed_stream_is_signed_and_has_no_frequency() -> None:
    profile = load_profile("wtvb01-485-fast")
    decoder = FrameDecoder(profile)
    frame = frame_of(profile, {"displacement": (-5, 0, 32767)})
    (sample,) = decoder.samples(decoder.decode(frame), 1, 2)
    assert isinstance(sample, VibrationSample)
    assert sample.statistic == "instantaneous"
    assert sample.amplitude == pytest.approx([-5e-6, 0, 0.032767])
    assert np.isnan(sample.frequency_hz).all()
    assert sample.temperature_c is None


def test_a_frame_with_specific_force_makes_two_samples() -> None:
    decoder = FrameDecoder(load_profile("wtvb01-485"))
    vibration, force = decoder.samples(decoder.decode(CAPTURED_REPLY), 123, 7)
    assert isinstance(vibration, VibrationSample)
    assert isinstance(force, AccelerationSample)
    assert (vibration.t_ns, vibration.sequence) == (force.t_ns, force.sequence) == (123, 7)
    assert (vibration.quantity, vibration.statistic) == ("displacement", "peak")
    assert vibration.temperature_c == 20.96
    assert vibration.device_ticks == 51_702_974


def test_an_invalid_code_and_a_value_out_of_range_become_nan() -> None:
    profile = load_profile("aft601d")
    frame = frame_of(
        profile,
        {"displacement": (65535, 1, 2), "frequency": (10, 10001, 10000), "temperature": (-32768,)},
    )
    values = FrameDecoder(profile).decode(frame)
    assert values.fields["displacement"] == pytest.approx((math.nan, 1e-7, 2e-7), nan_ok=True)
    assert values.fields["frequency"] == pytest.approx((1.0, math.nan, 1000.0), nan_ok=True)
    assert math.isnan(values.fields["temperature"][0])
    decoder = FrameDecoder(profile)
    assert not decoder.plausible(frame)
    assert decoder.plausible(frame_of(profile, {"displacement": (65535, 65534, 0)}))


def test_axes_are_mapped_and_only_signed_quantities_change_sign() -> None:
    profile = _changed(load_profile("wtvb01-485"), axes=("-y", "x", "z"))
    frame = frame_of(profile, {"displacement": (1, 2, 3), "acceleration": (100, -200, 300)})
    decoder = FrameDecoder(profile)
    vibration, force = decoder.samples(decoder.decode(frame), 0, 0)
    assert isinstance(vibration, VibrationSample)
    assert isinstance(force, AccelerationSample)
    assert vibration.amplitude * 1e6 == pytest.approx([2, 1, 3])
    assert force.acceleration_m_s2 / 0.00478840332 == pytest.approx([200, 100, 300])


def test_the_device_clock_wraps() -> None:
    profile = load_profile("wtvb01-485")
    frame = bytearray(CAPTURED_REPLY)
    frame[5:11] = bytes([23, 0, 59, 59, 0x03, 0xE8])  # 23:59:59 and 1000 ms
    assert FrameDecoder(profile).decode(bytes(frame)).device_ticks == 0


def test_samples_are_frozen_and_their_arrays_read_only() -> None:
    decoder = FrameDecoder(load_profile("wtvb01-bt50"))
    (sample,) = decoder.samples(decoder.decode(MANUAL_FRAME), 0, 0)
    assert isinstance(sample, VibrationSample)
    with pytest.raises(ValueError, match="read-only"):
        sample.amplitude[0] = 1.0
    with pytest.raises(AttributeError):
        sample.t_ns = 1  # type: ignore[misc] # that is the test


@pytest.mark.parametrize("name", shipped_profiles())
@settings(deadline=None)
@given(data=st.binary(max_size=64))
def test_any_bytes_give_values_or_the_drivers_own_error(name: str, data: bytes) -> None:
    profile = load_profile(name)
    decoder = FrameDecoder(profile)
    if len(data) < profile.frame.shortest:
        with pytest.raises(DriverError, match=f"frame of {len(data)} bytes"):
            decoder.decode(data)
    else:
        decoder.samples(decoder.decode(data), 0, 0)


def test_a_float_field_that_is_not_finite_becomes_nan(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "drivers/vibration/profiles/aft601d.toml").read_text()
    text = text.replace('offsets = [18]\ntype = "int16"', 'offsets = [16]\ntype = "float32"')
    text = text.replace("offsets = [12, 14, 16]", "offsets = [10, 12, 14]")
    (tmp_path / "float.toml").write_text(text.replace("invalid = -32768\n", ""))
    profile = load_profile(tmp_path / "float.toml")
    for infinite in ("0000807f", "0000c07f"):  # inf, nan
        frame = bytearray(22)
        frame[16:20] = bytes.fromhex(infinite)
        assert math.isnan(FrameDecoder(profile).decode(bytes(frame)).fields["temperature"][0])
