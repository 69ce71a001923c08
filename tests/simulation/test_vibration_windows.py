import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.samples import VibrationQuantity, VibrationSample, VibrationStatistic
from drivers.vibration.acceleration import acceleration_m_s2
from simulation.devices.accelerometer import Accelerometer, accelerometer_signal
from simulation.devices.vibration_windows import (
    VibrationOutput,
    amplitude_and_frequency,
    vibration_stream,
)
from simulation.errors import SimulationError
from tests.simulation.motions import motion

TIME_S = np.asarray(np.arange(256) * 1e-3, np.float64)
QUIET = Accelerometer(noise_density_m_s2=0.0, bias_sigma_m_s2=0.0)


def test_the_published_example() -> None:
    """67 um at 37 Hz are 3.62 m/s^2 (WitMotion WTVB01-BT50)."""
    wave = 3.62 * np.sin(2 * math.pi * 37.0 * TIME_S)
    amplitude, frequency = amplitude_and_frequency(wave, 1000.0, VibrationOutput())
    assert float(amplitude) == pytest.approx(67e-6, rel=0.02)
    assert float(frequency) == pytest.approx(37.0, abs=0.2)


@given(
    st.floats(12.0, 450.0),
    st.floats(0.0, 6.28),
    st.floats(0.01, 50.0),
    st.sampled_from(["displacement", "velocity", "acceleration"]),
    st.sampled_from(["peak", "peak-to-peak", "rms"]),
)
def test_the_drivers_formula_gives_a_tones_acceleration_back(
    frequency_hz: float,
    phase: float,
    peak: float,
    quantity: VibrationQuantity,
    statistic: VibrationStatistic,
) -> None:
    output = VibrationOutput(quantity=quantity, statistic=statistic)
    wave = 9.8 + peak * np.sin(2 * math.pi * frequency_hz * TIME_S + phase)
    amplitude, frequency = amplitude_and_frequency(wave, 1000.0, output)
    assert float(frequency) == pytest.approx(frequency_hz, abs=0.5)
    back = float(acceleration_m_s2(amplitude, frequency, quantity, statistic))
    assert back == pytest.approx(peak, rel=0.05)


def test_slow_tilting_is_no_vibration() -> None:
    ramp = 9.8 + 3.0 * TIME_S
    amplitude, _ = amplitude_and_frequency(ramp, 1000.0, VibrationOutput(quantity="acceleration"))
    assert float(amplitude) < 1e-9


def test_frequencies_outside_the_band_are_not_seen() -> None:
    wave = np.sin(2 * math.pi * 300.0 * TIME_S) + 0.1 * np.sin(2 * math.pi * 40.0 * TIME_S)
    output = VibrationOutput(band_hz=(5.0, 100.0), quantity="acceleration")
    amplitude, frequency = amplitude_and_frequency(wave, 1000.0, output)
    assert float(amplitude) == pytest.approx(0.1, rel=0.05)
    assert float(frequency) == pytest.approx(40.0, abs=0.5)


def test_the_stream_has_the_devices_clock_and_steps() -> None:
    t = np.arange(3001) * 1e-3
    acceleration = np.zeros((3001, 3))
    acceleration[:, 2] = 9.8 + 2.0 * np.sin(2 * math.pi * 50.0 * t)
    shaking = motion(3.0, acceleration_m_s2=acceleration)
    random = np.random.default_rng(2)
    signal = accelerometer_signal(shaking, QUIET, (), random)
    output = VibrationOutput(offset_s=4294.0, window_s=0.2)
    stream = vibration_stream(shaking, QUIET, signal, output, (), random)
    samples = [sample for sample in stream if isinstance(sample, VibrationSample)]
    assert len(samples) == pytest.approx(280, abs=1)
    ticks = np.array([sample.device_ticks for sample in samples], np.int64)
    assert ticks.min() >= 0
    assert np.count_nonzero(np.diff(ticks) < 0) == 1  # 2^32 us are 4294.97 s
    lengths = np.diff(ticks)[np.diff(ticks) > 0]
    assert lengths == pytest.approx(10_000, abs=1)
    assert np.diff(stream.measured_ns).mean() == pytest.approx(1e7 / (1 + 35e-6), rel=1e-6)
    z = samples[100]
    assert z.amplitude[2] == pytest.approx(2.0 / (2 * math.pi * 50.0) ** 2, rel=0.02)
    assert z.frequency_hz[2] == pytest.approx(50.0, abs=0.2)
    assert z.amplitude[2] / 1e-7 == pytest.approx(round(z.amplitude[2] / 1e-7))
    assert (z.quantity, z.statistic) == ("displacement", "peak")


def test_what_the_register_cannot_hold_has_no_value() -> None:
    still = motion(0.3)
    signal = accelerometer_signal(still, Accelerometer(), (), np.random.default_rng(3))

    def samples(largest_count: int) -> list[VibrationSample]:
        output = VibrationOutput(largest_count=largest_count)
        random = np.random.default_rng(3)
        stream = vibration_stream(still, Accelerometer(), signal, output, (), random)
        return [sample for sample in stream if isinstance(sample, VibrationSample)]

    whole, low = samples(2**16 - 2)[0], samples(1000)[0]
    assert np.isfinite(whole.frequency_hz).all()
    above = whole.frequency_hz > 100.0
    assert above.any()
    np.testing.assert_array_equal(np.isnan(low.frequency_hz), above)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"statistic": "instantaneous"}, "statistic"),
        ({"window_s": 0.0}, "window_s"),
        ({"rate_hz": -1.0}, "rate_hz"),
        ({"band_hz": (0.0, 100.0)}, "band_hz"),
    ],
)
def test_impossible_outputs(settings: dict[str, object], message: str) -> None:
    with pytest.raises(SimulationError, match=message):
        VibrationOutput(**settings)  # type: ignore[arg-type] # that is the point


def test_a_run_shorter_than_a_window_is_refused() -> None:
    random = np.random.default_rng(2)
    short = motion(0.2)
    signal = accelerometer_signal(short, QUIET, (), random)
    with pytest.raises(SimulationError, match="shorter than a vibration window"):
        vibration_stream(short, QUIET, signal, VibrationOutput(), (), random)
