import math
from dataclasses import replace

import numpy as np
import pytest

from drivers.gyro.chips import CHIPS, decode
from drivers.samples import AccelerationSample, YawRateSample
from simulation.devices.accelerometer import (
    Accelerometer,
    acceleration_stream,
    accelerometer_signal,
)
from simulation.devices.yaw_gyro import Gyro, Warming, gyro_stream
from simulation.faults import AccelerometerBias
from tests.simulation.motions import motion

UPSIDE_DOWN = (math.pi, 0.0, 0.0)


def random() -> np.random.Generator:
    return np.random.default_rng(5)


def test_an_accelerometer_at_rest_reads_gravity_its_bias_and_noise() -> None:
    settings = Accelerometer()
    signal = accelerometer_signal(motion(20.0), settings, (), random())
    values = signal.acceleration_m_s2
    assert len(values) == pytest.approx(20_000, abs=2)
    offsets = values.mean(axis=0) - [0.0, 0.0, 9.80665]
    assert 0.001 < np.abs(offsets).max() < 0.08
    assert values.std(axis=0) == pytest.approx([0.002 * math.sqrt(500.0)] * 3, rel=0.03)
    steps = values / settings.quantum_m_s2
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)


def test_an_accelerometer_reports_in_its_own_axes() -> None:
    settings = Accelerometer(rotation_rad=UPSIDE_DOWN, noise_density_m_s2=0.0, bias_sigma_m_s2=0.0)
    still = motion(1.0, acceleration_m_s2=(0.5, 1.0, 9.8))
    values = accelerometer_signal(still, settings, (), random()).acceleration_m_s2
    np.testing.assert_allclose(values.mean(axis=0), [0.5, -1.0, -9.8], atol=0.003)


def test_an_accelerometer_saturates() -> None:
    settings = Accelerometer(noise_density_m_s2=0.0, bias_sigma_m_s2=0.0)
    shaken = motion(0.1, acceleration_m_s2=(500.0, -500.0, 9.8))
    values = accelerometer_signal(shaken, settings, (), random()).acceleration_m_s2
    full_scale = 16.0 * 9.80665
    assert values[-1] == pytest.approx([full_scale, -full_scale, 9.8], abs=0.005)


def test_a_bias_fault_starts_and_ends() -> None:
    fault = AccelerometerBias(start_s=1.0, duration_s=0.5, bias_m_s2=(0.3, 0.0, -0.2))
    settings = Accelerometer(noise_density_m_s2=0.0, bias_sigma_m_s2=0.0)
    stream_random = random()
    still = motion(2.0)
    signal = accelerometer_signal(still, settings, (fault,), stream_random)
    stream = acceleration_stream(still, settings, signal, (), stream_random)
    elapsed = still.elapsed_s(stream.measured_ns)
    samples = [s for s in stream if isinstance(s, AccelerationSample)]
    x = np.array([sample.acceleration_m_s2[0] for sample in samples])
    inside = (elapsed >= 1.0) & (elapsed < 1.5)
    assert x[inside] == pytest.approx(0.3, abs=0.003)
    assert not x[~inside].any()


def test_the_drivetrain_hums_with_the_wheels_alone() -> None:
    quiet = Accelerometer(noise_density_m_s2=0.0, bias_sigma_m_s2=0.0, hum=((24.0, 0.2),))
    rolling = motion(4.0, wheel_rate_rad_s=[3.0] * 4)
    values = accelerometer_signal(rolling, quiet, (), random()).acceleration_m_s2
    spectrum = np.abs(np.fft.rfft(values[:4000] - values[:4000].mean(axis=0), axis=0))
    tone_hz = np.fft.rfftfreq(4000, 1e-3)[spectrum.argmax(axis=0)]
    assert tone_hz == pytest.approx(24.0 * 3.0 / (2 * math.pi), abs=0.25)
    still = accelerometer_signal(motion(4.0), quiet, (), random()).acceleration_m_s2
    assert not still.std(axis=0).any()


def gyro_samples(settings: Gyro, seconds: float, rate_rad_s: float) -> list[YawRateSample]:
    turning = motion(seconds, body_rate_rad_s=(0.1, -0.2, rate_rad_s))
    stream = gyro_stream(turning, settings, (), random())
    return [sample for sample in stream if isinstance(sample, YawRateSample)]


def test_a_perfect_gyro_reports_the_yaw_rate_to_a_count() -> None:
    settings = Gyro(
        noise_density_rad_s=0.0, bias_sigma_rad_s=0.0, bias_walk_rad_s=0.0, bias_per_c=0.0
    )
    samples = gyro_samples(settings, 1.0, 0.4)
    assert len(samples) in (199, 200)
    assert [s.rate_rad_s for s in samples] == pytest.approx([0.4] * len(samples), abs=3e-7)
    turned = gyro_samples(Gyro(rotation_rad=UPSIDE_DOWN), 1.0, 0.4)
    assert np.mean([s.rate_rad_s for s in turned]) == pytest.approx(-0.4, abs=0.04)


def test_counts_are_those_that_the_driver_decodes() -> None:
    for sample in gyro_samples(Gyro(), 0.5, -0.2):
        assert sample.raw_counts is not None
        data = sample.raw_counts.to_bytes(3, "big", signed=True)
        assert decode(CHIPS["xv7001bb"], data) == (sample.raw_counts, sample.rate_rad_s)


def test_the_register_saturates() -> None:
    settings = Gyro(deg_s_per_count=0.00875, bits=16)
    assert {s.raw_counts for s in gyro_samples(settings, 0.1, 50.0)} == {32767}


def test_gyro_errors_have_their_sizes() -> None:
    steady = Warming(25.0, 0.0)
    rates = []
    for seed in range(200):
        stream = gyro_stream(motion(0.3), Gyro(warming=steady), (), np.random.default_rng(seed))
        rates.append([s.rate_rad_s for s in stream if isinstance(s, YawRateSample)][:50])
    assert np.mean(rates, axis=1).std() == pytest.approx(0.01, rel=0.15)
    assert np.std(rates, axis=1).mean() == pytest.approx(8.7e-4, rel=0.05)


def test_the_bias_follows_temperature_and_walks() -> None:
    silent = Gyro(noise_density_rad_s=0.0, bias_sigma_rad_s=0.0)
    warming = Warming(25.0, 10.0, 30.0)
    hot = gyro_samples(replace(silent, bias_walk_rad_s=0.0, warming=warming), 60.0, 0.0)
    expected_c = 25.0 + 10.0 * (1.0 - math.exp(-2.0))
    assert hot[-1].temperature_c == pytest.approx(expected_c, abs=0.05)
    assert hot[-1].rate_rad_s == pytest.approx(1e-4 * (expected_c - 25.0), rel=0.01)
    walk = gyro_samples(replace(silent, bias_walk_rad_s=1e-3, bias_per_c=0.0), 60.0, 0.0)
    steps = np.diff([sample.rate_rad_s for sample in walk])
    assert steps.std() * math.sqrt(200.0) == pytest.approx(1e-3, rel=0.05)
