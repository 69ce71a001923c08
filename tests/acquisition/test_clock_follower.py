"""A device's own clock: followed while recording, told on /clock, and used afterwards."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest

from acquisition.clocks.clock_follower import DEFAULT_TUNING, ClockFollower, ClockTuning
from acquisition.clocks.clock_sample import ClockSample
from acquisition.clocks.corrected_stamps import (
    DeviceTimes,
    clock_settings_of,
    corrected_stamps,
)
from acquisition.errors import StreamError
from acquisition.recording.plan import RecordingPlan
from acquisition.recording.recorder import Recorder
from acquisition.stream.writer import StreamWriter
from drivers.samples import DepthFrame, VibrationSample
from drivers.source import SourceInfo, TickCounter
from tests.fakes.clocks import DeviceMessages, kinect
from tests.fakes.device_samples import vibration
from tests.fakes.recorder_runs import QUICK, SecondsClock, of_type, output, read
from tests.fakes.recordings import START_NS, depth_frame
from tests.fakes.scripted_source import ScriptedSource

S = 1_000_000_000
COUNTER = TickCounter(60e6, 1 << 32)
HOST = ClockSample(0, "host", 100 * S, 101 * S, 1000 * S, "boot", 7, event="suspend", event_ns=3)


def shown(messages: DeviceMessages) -> list[tuple[int, int]]:
    """Return what the counter of 32 bits showed, and when it arrived."""
    ticks = messages.ticks % (1 << 32)
    return list(zip(ticks.tolist(), messages.arrival_ns.tolist(), strict=True))


def follow(messages: DeviceMessages, tuning: ClockTuning = DEFAULT_TUNING) -> ClockFollower:
    follower = ClockFollower(tuning)
    follower.begin(COUNTER)
    for ticks, arrival_ns in shown(messages):
        follower.take(ticks, arrival_ns)
    return follower


def test_the_rate_of_a_device_is_found_across_wraps_of_its_counter() -> None:
    follower = follow(kinect(1, seconds=80.0))
    # Fast by 40 ppm: a second of the device is shorter than one of the host.
    assert follower.skew_ppm == pytest.approx(-40.0, abs=3.0)


def test_the_rate_is_not_told_before_it_is_known() -> None:
    follower = follow(kinect(1, seconds=9.0))
    assert follower.skew_ppm is None
    follower.begin(COUNTER)
    assert follower.samples("camera", HOST) == []


def test_the_clamp_is_the_users() -> None:
    messages = kinect(1, seconds=30.0, drift_ppm=9000.0)
    assert follow(messages).skew_ppm == pytest.approx(-500.0)
    wide = follow(messages, ClockTuning(max_drift_ppm=20_000.0)).skew_ppm
    assert wide == pytest.approx(-9000.0 / 1.009, abs=30.0)


def test_what_is_told_is_the_last_message_and_once() -> None:
    messages = kinect(2, seconds=20.0)
    follower = follow(messages, ClockTuning(min_delay_ns=8_000_000))
    host = replace(HOST, host_monotonic_ns=int(messages.arrival_ns[-1]) + 5)
    (said,) = follower.samples("camera", host)
    ticks, arrival_ns = shown(messages)[-1]
    assert (said.source, said.device_ticks, said.event) == ("camera", ticks, "")
    assert (said.host_monotonic_ns, said.host_raw_ns) == (arrival_ns, host.host_raw_ns - 5)
    assert said.host_real_ns == host.host_real_ns - 5
    unwrapped = int(messages.ticks[-1] - messages.ticks[0]) + shown(messages)[0][0]
    happened_ns = unwrapped * 1e9 / 60e6 + said.offset_ns
    assert happened_ns == pytest.approx(int(messages.event_ns[-1]), abs=1e6)
    assert follower.samples("camera", host) == []


def test_a_device_that_begins_anew_is_told() -> None:
    follower = follow(kinect(1, seconds=20.0))
    ticks, arrival_ns = shown(kinect(1, seconds=20.0))[-1]
    follower.take(ticks - 60_000_000, arrival_ns + 33_000_000)
    said = follower.samples("camera", HOST)
    assert [sample.event for sample in said] == ["", "device_restart"]


def test_a_counter_that_makes_no_sense_ends_no_recording() -> None:
    follower = ClockFollower(ClockTuning())
    follower.begin(TickCounter(1e6, 3))
    follower.take(1, S)
    assert (follower.is_following(), follower.skew_ppm) == (False, None)
    assert "wrap_ticks" in follower.problem
    follower.begin(COUNTER)
    assert follower.problem == ""


def test_without_a_known_rate_nothing_is_followed() -> None:
    follower = ClockFollower(ClockTuning())
    follower.begin(None)
    follower.take(5, S)
    assert follower.samples("camera", HOST) == []
    assert ClockTuning(1e6).settings(None) == ClockTuning().settings(TickCounter(1e6))


class Behind(SecondsClock):
    """Looks at the host's clocks when all has arrived."""

    def __init__(self, now_ns: int) -> None:
        super().__init__()
        self._now_ns = now_ns

    def samples(self, sequence: int) -> list[ClockSample]:
        t_ns = self._now_ns
        return [replace(HOST, t_ns=t_ns, host_monotonic_ns=t_ns, sequence=sequence)]


def test_a_recording_tells_its_devices_clocks_and_keeps_its_stamps(tmp_path: Path) -> None:
    messages = shown(kinect(3, seconds=12.0))
    frames = [
        [replace(depth_frame(i, arrival_ns), device_ticks=ticks)]
        for i, (ticks, arrival_ns) in enumerate(messages)
    ]
    camera = ScriptedSource("camera", frames, produces=(DepthFrame,), counter=COUNTER)
    imu = ScriptedSource("imu", [])
    recorder = Recorder([camera, imu], output(tmp_path / "r.mcap"), QUICK, Behind(messages[-1][1]))
    result = recorder.run(Event())
    found, _ = read(tmp_path / "r.mcap")
    clocks = of_type(found, ClockSample)
    assert [clock.sequence for clock in clocks] == list(range(len(clocks)))
    told = [clock for clock in clocks if clock.source == "camera"]
    assert told
    assert told[-1].device_ticks == messages[-1][0]
    stamps = [frame.t_ns - START_NS for frame in of_type(found, DepthFrame)]
    assert stamps == [arrival_ns for _, arrival_ns in messages]
    health = {source.name: source.clock_skew_ppm for source in result.health.sources}
    assert health["camera"] is not None
    assert health["imu"] is None


def settings_for(name: str, tuning: ClockTuning) -> dict[str, Any]:
    return {"device_clocks": {name: asdict(tuning)}}


def test_a_recording_is_corrected_afterwards(tmp_path: Path) -> None:
    messages = kinect(4, seconds=90.0)
    path = tmp_path / "r.mcap"
    info = SourceInfo("camera", "kinect", "", (DepthFrame,), "monotonic", counter=COUNTER)
    settings = settings_for("camera", ClockTuning(min_delay_ns=8_000_000))
    with StreamWriter(path, sources=[info], static_transforms=[], settings=settings) as writer:
        for number, (ticks, arrival_ns) in enumerate(shown(messages)):
            frame = depth_frame(number, START_NS + arrival_ns)
            writer.write(replace(frame, device_ticks=ticks))
    found = list(corrected_stamps([path]))
    assert [stamp.sequence for stamp in found] == list(range(len(messages.ticks)))
    assert {stamp.topic for stamp in found} == {"/depth/image"}
    corrected_ns = np.array([stamp.corrected_ns - START_NS for stamp in found])
    error_ms = (corrected_ns - messages.event_ns)[60 * 30 :] * 1e-6
    assert error_ms.std() <= 0.02
    assert np.quantile(np.abs(error_ms), 0.99) <= 0.05


def test_only_what_has_a_clock_is_corrected() -> None:
    metadata = {
        "terravibe": {
            "settings": "{}",
            "source.v": '{"produces": ["VibrationSample"], "counter": {"rate_hz": 1000.0}}',
            "source.d": '{"produces": ["DepthFrame"], "counter": null}',
        }
    }
    times = DeviceTimes(clock_settings_of(metadata))
    with_ticks = replace(vibration(0, START_NS), device_ticks=5)
    assert isinstance(with_ticks, VibrationSample)
    assert times.corrected_ns(with_ticks) == START_NS
    assert times.corrected_ns(replace(with_ticks, device_ticks=None)) is None
    assert times.corrected_ns(replace(depth_frame(0), device_ticks=5)) is None
    assert times.corrected_ns(RecordingPlan()) is None
    assert clock_settings_of({}) == {}


@pytest.mark.parametrize(
    ("key", "text"),
    [
        ("source.v", '{"produces": ["A"], "counter": {"rate": 1.0}}'),
        ("source.v", '{"produces": ["A"], "counter": {"rate_hz": -1.0}}'),
        ("source.v", '{"counter": {"rate_hz": 1.0}}'),
        ("source.v", "["),
        ("settings", "[]"),
    ],
)
def test_clocks_that_make_no_sense_are_one_line(key: str, text: str) -> None:
    with pytest.raises(StreamError) as caught:
        clock_settings_of({"terravibe": {key: text}})
    assert "\n" not in str(caught.value)
