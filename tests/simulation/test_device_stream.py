import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.samples import AccelerationSample, Sample, frozen_array
from simulation.devices.device_stream import DeviceClock, DeviceStream, increasing
from simulation.errors import SimulationError

START_NS = 10**15


def test_a_fast_clock_measures_more_often() -> None:
    clock = DeviceClock(200.0, drift_ppm=500.0)
    edges = clock.edges_ns(START_NS, 100_000_000_000, np.random.default_rng(1))
    assert np.diff(edges).mean() == pytest.approx(5e6 / 1.0005, rel=1e-7)
    assert np.diff(edges).std() < 1.0
    assert START_NS <= edges[0] < START_NS + 5_000_000
    assert START_NS + 99_995_000_000 < edges[-1] <= START_NS + 100_000_000_000


def test_a_run_shorter_than_the_period_has_no_samples() -> None:
    assert len(DeviceClock(1.0).edges_ns(0, 1000, np.random.default_rng(0))) == 1


@given(st.integers(0, 2**32), st.floats(0.0, 0.05), st.floats(0.0, 0.05))
def test_stamps_are_late_and_strictly_increase(seed: int, latency: float, jitter: float) -> None:
    clock = DeviceClock(100.0, latency_s=latency, jitter_s=jitter)
    measured = START_NS + 10_000_000 * np.arange(50)
    stamps = clock.stamps_ns(measured, np.random.default_rng(seed))
    assert np.all(np.diff(stamps) > 0)
    assert np.all(stamps - measured >= round(latency * 1e9))


def test_times_are_put_off_only_where_they_must() -> None:
    assert increasing(np.array([5, 3, 3, 9])).tolist() == [5, 6, 7, 9]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"rate_hz": 0.0}, "rate_hz"),
        ({"rate_hz": 5000.0}, "rate_hz"),
        ({"rate_hz": 10.0, "drift_ppm": 1e5}, "drift_ppm"),
        ({"rate_hz": 10.0, "latency_s": -1.0}, "latency_s"),
        ({"rate_hz": 10.0, "jitter_s": np.nan}, "jitter_s"),
    ],
)
def test_impossible_clocks(settings: dict[str, float], message: str) -> None:
    with pytest.raises(SimulationError, match=message):
        DeviceClock(**settings)


def make(index: int, sequence: int) -> Sample:
    return AccelerationSample(index, frozen_array(np.zeros(3), (3,)), sequence)


@pytest.mark.parametrize(("counts_lost", "sequences"), [(True, [0, 3, 4]), (False, [0, 1, 2])])
def test_lost_samples_leave_a_gap_where_the_device_numbers_them(
    counts_lost: bool, sequences: list[int]
) -> None:
    arrived = np.array([True, False, False, True, True])
    stream = DeviceStream("vibration", AccelerationSample, np.arange(5), arrived, make, counts_lost)
    for _ in range(2):
        samples = list(stream)
        assert [sample.t_ns for sample in samples] == [0, 3, 4]
        assert [sample.sequence for sample in samples] == sequences
    assert len(stream) == 3
