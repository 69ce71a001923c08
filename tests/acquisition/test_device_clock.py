"""Device clocks: how exact, how monotone, and what a jump does."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.clocks.device_clock import DeviceClock, DeviceClockSettings, unwrapped
from acquisition.errors import StreamError
from tests.fakes.clocks import DeviceMessages, Int64Array, kinect

MS = 1_000_000
KINECT = DeviceClockSettings(60e6, 1 << 32, min_delay_ns=8 * MS)
WARM_UP = 300  # messages, 10 s


def translated(
    messages: DeviceMessages, settings: DeviceClockSettings = KINECT
) -> tuple[Int64Array, DeviceClock]:
    """Return the translated times of messages whose counter wraps, and the clock."""
    clock = DeviceClock(settings)
    ticks = messages.ticks
    if settings.wrap_ticks is not None:
        ticks = ticks % settings.wrap_ticks
    pairs = zip(ticks.tolist(), messages.arrival_ns.tolist(), strict=True)
    return np.array([clock.translate(*pair) for pair in pairs]), clock


@pytest.mark.parametrize("seed", range(4))
def test_the_simulated_kinect_is_as_exact_as_it_must_be(seed: int) -> None:
    """300 s: the 60 MHz counter wraps four times."""
    messages = kinect(seed)
    times_ns, clock = translated(messages)
    error_ms = (times_ns - messages.event_ns) * 1e-6
    assert (messages.arrival_ns - messages.event_ns).std() > 3.0 * MS
    full_window_ms = error_ms[1800:]
    assert full_window_ms.std() <= 0.02
    assert np.quantile(np.abs(full_window_ms), 0.99) <= 0.05
    assert np.quantile(np.abs(error_ms[WARM_UP:]), 0.99) <= 0.1
    assert clock.skew_ppm == pytest.approx(-40.0, abs=2.0)
    assert clock.take_events() == []


def test_the_offset_relates_ticks_and_times() -> None:
    messages = kinect(0, seconds=100.0)
    times_ns, clock = translated(messages, DeviceClockSettings(60e6, None))
    device_ns = messages.ticks[-1] / 60e6 * 1e9
    assert clock.offset_ns == pytest.approx(times_ns[-1] - device_ns, abs=100)


def test_a_year_does_not_round() -> None:
    messages = kinect(0, seconds=60.0)
    year_ns = 365 * 86400 * 10**9
    moved = DeviceMessages(
        messages.event_ns + year_ns,
        messages.ticks + year_ns * 3 // 50,
        messages.arrival_ns + year_ns,
    )
    settings = DeviceClockSettings(60e6, None)
    times_ns, _ = translated(messages, settings)
    later_ns, _ = translated(moved, settings)
    np.testing.assert_array_equal(later_ns - year_ns, times_ns)


def test_a_slow_rc_clock_needs_a_wider_clamp() -> None:
    messages = kinect(1, drift_ppm=9000.0, tick_rate_hz=1e6, seconds=120.0)
    wide = DeviceClockSettings(1e6, 1 << 32, max_drift_ppm=15000.0, min_delay_ns=8 * MS)
    error_ms = (translated(messages, wide)[0] - messages.event_ns)[WARM_UP:] * 1e-6
    assert error_ms.std() <= 0.02


@pytest.mark.parametrize(("drift_ppm", "pinned_ppm"), [(9000.0, -500.0), (-9000.0, 500.0)])
def test_a_clamp_that_is_too_narrow_shows(drift_ppm: float, pinned_ppm: float) -> None:
    messages = kinect(1, drift_ppm=drift_ppm, tick_rate_hz=1e6, seconds=120.0)
    times_ns, clock = translated(messages, DeviceClockSettings(1e6, 1 << 32))
    assert clock.skew_ppm == pytest.approx(pinned_ppm)
    # A slow clock falls behind the line and seems to jump again and again; a fast one cannot.
    assert bool(clock.take_events()) == (drift_ppm < 0)
    assert (np.diff(times_ns) >= 0).all()
    assert (times_ns <= messages.arrival_ns).all()


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.floats(-400.0, 400.0),
    st.sampled_from((0.0, 0.01, 0.3)),
    st.sampled_from((8, 30, 1000)),
    st.sampled_from((2.0, 60.0)),
)
def test_times_rise_and_are_never_behind_the_arrival(
    seed: int, drift_ppm: float, stall_share: float, rate_hz: float, window_s: float
) -> None:
    messages = kinect(
        seed, seconds=400 / rate_hz, rate_hz=rate_hz, drift_ppm=drift_ppm, stall_share=stall_share
    )
    settings_ = DeviceClockSettings(60e6, 1 << 32, window_s=window_s)
    times_ns, clock = translated(messages, settings_)
    assert (np.diff(times_ns) >= 0).all()
    assert (times_ns <= messages.arrival_ns).all()
    assert abs(clock.skew_ppm) <= 500.0 + 1e-6
    assert clock.take_events() == []


@given(st.lists(st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 10**10)), max_size=60))
def test_nonsense_gives_rising_times_too(pairs: list[tuple[int, int]]) -> None:
    clock = DeviceClock(DeviceClockSettings(60e6, 1 << 32))
    arrival_ns = last_ns = 0
    for ticks, wait_ns in pairs:
        arrival_ns += wait_ns
        t_ns = clock.translate(ticks, arrival_ns)
        assert last_ns <= t_ns <= arrival_ns
        last_ns = t_ns


@given(st.integers(256, 2**64), st.integers(0, 2**70), st.data())
def test_unwrapping_finds_the_nearest_value(wrap: int, truth: int, draw: st.DataObject) -> None:
    nearest = (wrap - 1) // 2
    expected = truth + draw.draw(st.integers(-nearest, nearest))
    assert unwrapped(truth % wrap, wrap, expected) == truth


def test_a_pause_of_many_wraps_is_bridged() -> None:
    messages = kinect(2, seconds=600.0)
    keep = np.r_[0:900, 9000:18000]  # 270 s without a message, more than three wraps
    paused = DeviceMessages(*(field[keep] for field in vars(messages).values()))
    times_ns, clock = translated(paused)
    error_ms = (times_ns - paused.event_ns) * 1e-6
    # The first messages behind the pause are as late as their arrival, the later ones are not.
    assert np.abs(error_ms[900:]).max() < 80.0
    assert np.abs(error_ms[900 + WARM_UP :]).max() < 0.2
    assert clock.take_events() == []


def jumped(messages: DeviceMessages, at: int, ticks: int) -> DeviceMessages:
    """Return the messages of a device whose counter jumps by so many ticks."""
    changed = messages.ticks.copy()
    changed[at:] += ticks
    return DeviceMessages(messages.event_ns, changed, messages.arrival_ns)


@pytest.mark.parametrize("jump_s", [5.0, 0.3, -0.3, -5.0])
@pytest.mark.parametrize("wrap", [1 << 32, None])
def test_a_jump_is_told_and_survived(jump_s: float, wrap: int | None) -> None:
    messages = jumped(kinect(3, seconds=120.0), 1800, round(jump_s * 60e6))
    times_ns, clock = translated(messages, DeviceClockSettings(60e6, wrap, min_delay_ns=8 * MS))
    (event,) = clock.take_events()
    assert event.kind == ("device_restart" if jump_s < -0.1 else "device_step")
    assert event.amount_ns == pytest.approx(jump_s * 1e9, abs=100 * MS)
    assert 0 <= event.monotonic_ns - messages.arrival_ns[1800] <= 2.2e9
    assert (np.diff(times_ns) >= 0).all()
    assert (times_ns <= messages.arrival_ns).all()
    # Ten seconds later nothing of it is left.
    error_ms = (times_ns - messages.event_ns)[1800 + WARM_UP :] * 1e-6
    assert error_ms.std() <= 0.02
    assert np.abs(error_ms).max() < 0.2


def test_a_clock_that_falls_back_by_less_than_a_frame_is_found_by_its_lateness() -> None:
    """At 2 Hz the counter still rises from frame to frame although it lost 0.3 s."""
    messages = jumped(kinect(4, seconds=300.0, rate_hz=2.0), 300, round(-0.3 * 60e6))
    times_ns, clock = translated(messages)
    (event,) = clock.take_events()
    assert event.kind == "device_step"
    assert event.amount_ns == pytest.approx(-0.3e9, abs=20 * MS)
    assert (np.diff(times_ns) >= 0).all()


def test_a_stall_of_the_connection_is_no_jump() -> None:
    messages = kinect(5, seconds=60.0)
    arrival_ns = messages.arrival_ns.copy()
    arrival_ns[900:945] = arrival_ns[945]  # 1.5 s, then all of them at once
    stalled = DeviceMessages(messages.event_ns, messages.ticks, arrival_ns)
    times_ns, clock = translated(stalled)
    assert clock.take_events() == []
    assert np.abs(times_ns - messages.event_ns)[WARM_UP:].max() < 0.2 * MS


def test_a_repeated_message_gets_the_same_time() -> None:
    clock = DeviceClock(DeviceClockSettings(1000.0))
    first = clock.translate(1000, 5_000 * MS)
    assert clock.translate(1000, 5_003 * MS) == first == 5_000 * MS
    assert clock.translate(1033, 5_033 * MS) == 5_033 * MS
    assert clock.take_events() == []


@pytest.mark.parametrize(
    "values",
    [
        {"tick_rate_hz": 0.0},
        {"tick_rate_hz": float("nan")},
        {"tick_rate_hz": 1.0, "window_s": 0.0},
        {"tick_rate_hz": 1.0, "max_drift_ppm": 1e6},
        {"tick_rate_hz": 1.0, "min_delay_ns": -1},
        {"tick_rate_hz": 1.0, "wrap_ticks": 255},
    ],
)
def test_settings_that_make_no_sense_are_refused(values: dict[str, float]) -> None:
    with pytest.raises(StreamError, match="DeviceClockSettings"):
        DeviceClockSettings(**values)  # type: ignore[arg-type]  # one type for all of them
