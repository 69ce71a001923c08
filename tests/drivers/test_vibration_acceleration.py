"""Acceleration of a single tone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.samples import VibrationQuantity
from drivers.vibration.acceleration import acceleration_m_s2


def test_67_micrometres_at_37_hertz() -> None:
    # The example frame of the WTVB01-BT50 manual; (2 pi 37)^2 * 67e-6
    a = acceleration_m_s2(67e-6, 37.0, "displacement", "peak")
    assert a == pytest.approx(3.62, abs=0.005)


@settings(deadline=None)
@given(
    peak_m=st.floats(1e-9, 1e-1),
    f_hz=st.floats(0.1, 1e4),
)
def test_against_the_derivatives_of_a_sine(peak_m: float, f_hz: float) -> None:
    t = np.linspace(0, 1 / f_hz, 2001)
    x = peak_m * np.sin(2 * np.pi * f_hz * t)
    v = np.gradient(x, t)
    a_peak = np.abs(np.gradient(v, t)[2:-2]).max()
    amplitudes: list[tuple[float, VibrationQuantity]] = [
        (peak_m, "displacement"),
        (np.abs(v).max(), "velocity"),
        (a_peak, "acceleration"),
    ]
    for peak, quantity in amplitudes:
        assert acceleration_m_s2(peak, f_hz, quantity, "peak") == pytest.approx(a_peak, rel=1e-4)
        rms = peak / np.sqrt(2)
        assert acceleration_m_s2(rms, f_hz, quantity, "rms") == pytest.approx(a_peak, rel=1e-4)
        both = acceleration_m_s2(2 * peak, f_hz, quantity, "peak-to-peak")
        assert both == pytest.approx(a_peak, rel=1e-4)


@pytest.mark.parametrize("quantity", ["displacement", "velocity", "acceleration"])
def test_outside_the_band_there_is_no_number(quantity: VibrationQuantity) -> None:
    f_hz = [4.9, 5.0, 100.0, 100.1, np.nan]
    a = acceleration_m_s2(np.ones(5), f_hz, quantity, "peak", band_hz=(5.0, 100.0))
    assert np.isnan(a).tolist() == [True, False, False, True, True]


def test_an_instantaneous_value_has_no_peak() -> None:
    assert np.isnan(
        acceleration_m_s2([1e-6] * 3, [50.0] * 3, "displacement", "instantaneous")
    ).all()


def test_an_invalid_amplitude_stays_invalid() -> None:
    a = acceleration_m_s2([np.nan, 0.0], [50.0, 50.0], "velocity", "rms")
    assert np.isnan(a[0])
    assert a[1] == 0.0
