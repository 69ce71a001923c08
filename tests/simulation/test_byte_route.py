"""The same drive twice into the recorder: as samples, and as bytes through the real drivers.

What the simulator says that a device reports must be what its driver makes of the device's bytes,
to the last bit of every number; only stamps may differ, the depth camera's own clock among them.
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from threading import Event, Timer

import pytest

from acquisition.inspection import inspect
from acquisition.recording.disk_output import DiskOutput
from acquisition.recording.folder_store import DiskSettings
from acquisition.recording.plan import RecordingPlan
from acquisition.recording.recorder import Recorder
from acquisition.recording.source_worker import WorkerSettings
from acquisition.stream.byte_source import FinishedFile
from acquisition.stream.reader import StreamReader
from drivers.depth.openni_depth import OpenNiDepth
from drivers.depth.openni_library import find_library, usual_folders
from drivers.errors import DriverError
from drivers.gyro.yaw_gyro import YawGyro
from drivers.samples import (
    AccelerationSample,
    CanFrameSample,
    DepthFrame,
    Sample,
    VibrationSample,
    WheelTwistSample,
    YawRateSample,
)
from drivers.source import Source
from drivers.vibration.sensor import VibrationSensor
from drivers.wheels.can_wheels import Wheels
from simulation.devices.camera_mount import on_rover
from simulation.devices.depth_camera import DepthCamera
from simulation.devices.kinect import KinectModel, kinect_320
from simulation.devices.vibration_windows import VibrationOutput
from simulation.devices.yaw_gyro import Gyro, Warming
from simulation.scenario_source import ScenarioSource
from simulation.scenarios import Scenario
from simulation.vehicle.drive_commands import Arc
from simulation.vehicle.vehicle_run import DriveOptions
from tests.fakes.fake_time import FakeTime
from tests.fakes.i2c_ioctl import FakeI2c
from tests.fakes.pty_endpoint import PtyEndpoint
from tests.fakes.recordings import bits
from tests.fakes.simulated_wires import (
    RAW_PROFILE,
    Finite,
    SerialSender,
    SignalGyro,
    can_lines,
    depth_file,
    pumping,
    raw_frames,
    vibration_frames,
)
from tests.fakes.slcan_pty import SlcanPty
from tests.simulation.grounds import sloping

PATIENCE_S = 20.0
FAST = Warming(time_s=2.0)
PLAN = RecordingPlan(
    preflight_timeout_s=120.0,  # the first source may compile kernels
    flush_interval_s=0.005,
    worker=WorkerSettings(read_timeout_s=0.05, reconnect_s=60.0),
)


def scenario() -> Scenario:
    """Return two seconds of a left turn, with devices that warm up so fast that it shows."""
    options = DriveOptions(
        rest_s=0.5, gyro=Gyro(warming=FAST), vibration=VibrationOutput(warming=FAST)
    )
    ground = sloping(half_size_m=6.0)
    camera = DepthCamera(ground, kinect_320(), KinectModel(), 4)
    return Scenario("turn", 4, 2.0, Arc(0.4, 2.0), options, camera, on_rover(), "true")


def record(path: Path, recorder: Recorder) -> list[Sample]:
    """Record until all sources have ended; return what is in the file, in its order."""
    stop = Event()
    timer = Timer(PATIENCE_S, stop.set)
    timer.start()
    try:
        result = recorder.run(stop)
    finally:
        timer.cancel()
        timer.join()
    assert (result.outcome, result.unwritten) == ("ended", 0), result.health
    with FinishedFile(path) as file:
        # The devices' clocks here have nothing to do with each other.
        reader = StreamReader(file, reorder_window_ns=2**62)
        found = [message.sample for message in reader if isinstance(message.sample, Sample)]
        assert reader.report.complete
        return found


def recorder_of(path: Path, *sources: Source) -> Recorder:
    return Recorder(sources, DiskOutput(path, DiskSettings(reserve_bytes=0)), PLAN)


def without_stamps(samples: Iterable[Sample], kind: type[Sample]) -> list[object]:
    """Return the samples of one kind, to the bit, but for what clocks say."""
    content: list[object] = []
    for sample in samples:
        if isinstance(sample, DepthFrame):
            sample = replace(sample, device_ticks=None)
        if isinstance(sample, kind):
            content.append(bits(replace(sample, t_ns=0)))
    return content


@pytest.fixture(scope="module")
def as_samples(tmp_path_factory: pytest.TempPathFactory) -> list[Sample]:
    """Record the drive by the sample route."""
    path = tmp_path_factory.mktemp("samples") / "samples.mcap"
    return record(path, recorder_of(path, ScenarioSource(scenario())))


def test_serial_i2c_and_can_bytes_become_the_same_recording(
    tmp_path: Path, as_samples: list[Sample], monkeypatch: pytest.MonkeyPatch
) -> None:
    time = FakeTime()
    i2c = FakeI2c(time)
    i2c.install(monkeypatch)
    yaw_rates = [s for s in as_samples if isinstance(s, YawRateSample)]
    chip = SignalGyro(time, yaw_rates, Gyro().clock.rate_hz * Gyro().clock.speed)
    i2c.plug("/dev/i2c-1", 0x6A, chip)
    frames = vibration_frames(s for s in as_samples if isinstance(s, VibrationSample))
    can_frames = [s for s in as_samples if isinstance(s, CanFrameSample)]
    twists = [s for s in as_samples if isinstance(s, WheelTwistSample)]
    path = tmp_path / "bytes.mcap"
    with PtyEndpoint(tmp_path / "ttyV") as serial, SlcanPty(tmp_path / "can0", seed=1) as adapter:
        sender = SerialSender(serial, frames)
        sensor = VibrationSensor(str(serial.path), clock_ns=sender.clock_ns)
        wheels = Wheels(
            str(adapter.path),
            interface="slcan",
            bus_options={"sleep_after_open": 0},
            clock=FakeTime(),  # stands still: no set of frames is too slow
        )
        recorder = recorder_of(
            path,
            Finite(sensor, len(frames)),
            Finite(YawGyro(1, clock=time, sleep=time.sleep), len(yaw_rates)),
            Finite(wheels, len(can_frames) + len(twists)),
        )
        assert not recorder.preflight().missing
        adapter.feed(can_lines(can_frames))
        with pumping(sender.pump, lambda: adapter.pump() > 0):
            as_bytes = record(path, recorder)
    counted = inspect(path).faults
    assert sorted(counted) == ["gyro", "vibration", "wheels"]
    assert not any(faults.losses() + faults.repairs() for faults in counted.values())
    # The bus has another name here than it could have in the simulation.
    expected = [
        replace(s, channel=str(tmp_path / "can0")) if isinstance(s, CanFrameSample) else s
        for s in as_samples
    ]
    assert (len(frames), len(yaw_rates), len(can_frames), len(twists)) == (175, 398, 396, 99)
    assert len({s.temperature_c for s in yaw_rates}) == 2
    for kind in (VibrationSample, YawRateSample, CanFrameSample, WheelTwistSample):
        assert without_stamps(as_bytes, kind) == without_stamps(expected, kind), kind


def test_raw_accelerations_over_a_serial_port_become_the_same_recording(
    tmp_path: Path, as_samples: list[Sample]
) -> None:
    profile = tmp_path / "raw.toml"
    profile.write_text(RAW_PROFILE)
    frames = raw_frames(profile, (s for s in as_samples if isinstance(s, AccelerationSample)))
    path = tmp_path / "bytes.mcap"
    with PtyEndpoint(tmp_path / "ttyA") as serial:
        sender = SerialSender(serial, frames)
        sensor = VibrationSensor(str(serial.path), profile, clock_ns=sender.clock_ns)
        recorder = recorder_of(path, Finite(sensor, 2 * len(frames)))
        assert not recorder.preflight().missing
        with pumping(sender.pump):
            as_bytes = record(path, recorder)
    assert len(frames) == 1999
    found, expected = (without_stamps(s, AccelerationSample) for s in (as_bytes, as_samples))
    assert found == expected


def test_an_openni_recording_becomes_the_same_depth(
    tmp_path: Path, as_samples: list[Sample]
) -> None:
    require_openni()
    frames = [s for s in as_samples if isinstance(s, DepthFrame)]
    depth_file(tmp_path / "drive.oni", frames)
    camera = OpenNiDepth(file=tmp_path / "drive.oni", intrinsics_px=(290.0, 290.0, 159.5, 119.5))
    path = tmp_path / "depth.mcap"
    as_bytes = record(path, recorder_of(path, camera))
    assert len(frames) == 20
    assert without_stamps(as_bytes, DepthFrame) == without_stamps(as_samples, DepthFrame)


def require_openni() -> None:
    """Skip without libOpenNI2; CI demands it by an environment variable."""
    give_up = pytest.fail if os.environ.get("TERRAVIBE_REQUIRE_DEVICES") == "1" else pytest.skip
    if importlib.util.find_spec("openni") is None:
        give_up("the package openni is missing")
    try:
        find_library(usual_folders())
    except DriverError as error:
        give_up(str(error))
