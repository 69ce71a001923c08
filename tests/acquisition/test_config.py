"""rover.toml: what it refuses and where, and what comes of it."""

from __future__ import annotations

import json
import math
import tomllib
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from acquisition.clocks.clock_follower import ClockTuning
from acquisition.config import use as config_use
from acquisition.config.model import KINDS, MapSection, RecordingSection, RoverConfig
from acquisition.config.rover_file import LoadedConfig, default_text, load, parse
from acquisition.errors import ConfigError
from acquisition.recording.disk_output import DiskOutput
from acquisition.recording.ring_output import RingOutput
from acquisition.replay import Replay
from drivers.errors import DriverError
from drivers.samples import DepthFrame
from mapping.recorded import recorded_settings
from mapping.settings import MapSettings

FILE = Path("/etc/terravibe/rover.toml")
FULL = """
[recording]
name = "moon"
flush_ms = 20
depth_format = "rvl"
queue_mb = 8
require_all = true

[[devices]]
kind = "png"
name = "depth"
folder = "frames"
intrinsics_px = [525.0, 525.0, 319.5, 239.5]
rate_hz = 30.0

[mounts.depth_optical_frame]
position_m = [0.2, 0, 0.35]
roll_pitch_yaw_deg = [-90, 0, -90]
sigma_m = 0.002
sigma_deg = 0.5

[rates_hz]
"/depth/image" = 30
"""

CIRCLE = """[mounts.a]
parent = "b"
position_m = [0, 0, 0]
roll_pitch_yaw_deg = [0, 0, 0]
[mounts.b]
parent = "a"
position_m = [0, 0, 0]
roll_pitch_yaw_deg = [0, 0, 0]
"""


def loaded(text: str, path: Path = FILE) -> LoadedConfig:
    return parse(text, path)


def test_the_default_text_says_every_default_and_names_every_key() -> None:
    text = default_text()
    assert loaded(text).config == RoverConfig()
    written = tomllib.loads(text)
    assert set(written["recording"]) == set(RecordingSection.model_fields)
    assert set(written["map"]) == set(MapSection.model_fields)
    for section in RoverConfig.model_fields:
        assert f"[{section}" in text


def test_an_empty_file_is_the_default() -> None:
    assert loaded("").config == RoverConfig()


def test_the_examples_in_the_default_text_are_valid() -> None:
    text = default_text()
    start, end = text.index("# [[devices]]"), text.index("# Expected rates")
    lines = [line.removeprefix("# ") for line in text[start:end].splitlines()]
    own = loaded("\n".join(line for line in lines if " = " in line or line.startswith("[")))
    assert {source.name for source in config_use.sources_of(own)} >= {"depth", "gyro", "wheels"}
    assert {entry.kind for entry in own.config.devices} == set(KINDS) - {"tum"}
    assert set(own.config.mounts) == {"depth_optical_frame", "mocap_body"}


def test_the_map_section_is_what_mapping_expects() -> None:
    expected = asdict(MapSettings())
    ours = MapSection().model_dump()
    assert ours.pop("ego_motion") == {}  # what is not said there stays as mapping has it
    assert ours == {name: expected[name] for name in ours}
    assert set(expected) - set(ours) == {"mount_sigma_m", "mount_sigma_rad", "ego_motion"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("\n[recording]\nflush = 3\n", ":3: recording.flush: unknown key; did you mean flush_ms"),
        ("[recording]\ngrid = 3\n", ":2: recording.grid: unknown key; did you mean map.grid?"),
        (
            "[map.gravity]\nwindows = 3\n",
            ":2: map.gravity.windows: unknown key; did you mean window_s",
        ),
        (
            "[[devices]]\nkind = 'png'\n[devices.clock]\ntick = 3\n",
            ":4: devices.0.clock.tick: unknown",
        ),
        ("[recordings]\n", ":1: recordings: unknown key"),
        ("[recording]\nflush_ms = 1\n", ":2: recording.flush_ms: Input should be greater"),
        ("[recording]\nflush_ms = '50'\n", ":2: recording.flush_ms: Input should be a valid int"),
        ("[recording]\nname = 'a/b'\n", ":2: recording.name: expected letters, digits, - and _"),
        ("[recording]\nfolder = 5\n", ":2: recording.folder: expected a text in quotes, found 5"),
        ("[recording]\nring_s = 1e300\n", ":2: recording.ring_s: Input should be less than or"),
        ("[recording]\nsplit_s = 1e300\n", ":2: recording.split_s: Input should be less than or"),
        ("[recording]\npreflight_s = 1e10\n", ":2: recording.preflight_s: Input should be less"),
        ("[recording]\nreconnect_s = 1e10\n", ":2: recording.reconnect_s: Input should be less"),
        ("[devices]\nkind = 'gyro'\n", ":1: devices: expected [[devices]] with two brackets"),
        ("devices = [5]\n", ":1: devices.0: expected a table, found 5"),
        ("devices = 5\n", ":1: devices: expected a list in [ ], found 5"),
        ("[map]\nresolution_m = nan\n", ":2: map.resolution_m: Input should be"),
        ("[map]\n\ngrid = 'round'\n", ":3: map.grid: Input should be 'growing' or 'scrolling'"),
        ("[[devices]]\nkind = 'png'\n[[devices]]\nkind = 'lidar'\n", ":4: devices.1.kind: no dev"),
        ("[[devices]]\nname = 'a'\n", ":1: devices.0.kind: is missing"),
        ("[rates_hz]\n'/lidar' = 3\n", ":1: rates_hz: no topic '/lidar'; expected one of /tf_sta"),
        ("[rates_hz]\n'/depth/image' = 0\n", ":2: rates_hz./depth/image: Input should be greater"),
        ("[mounts.cam]\nposition_m = [0, 0, 0]\n", ":1: mounts.cam: give either roll_pitch_yaw"),
        ("[mounts.cam]\nroll_pitch_yaw_deg = [0, 0, 0]\n", ":1: mounts.cam.position_m: is missing"),
        (
            "[mounts.cam]\nposition_m = [0, 0, 0]\nquaternion_wxyz = [2, 0, 0, 0]\n",
            ":1: mounts.cam: quaternion wxyz [2.0, 0.0, 0.0, 0.0] has length 2",
        ),
        (
            CIRCLE,
            ":1: mounts: a sits on itself",
        ),
        (
            "[[devices]]\nkind = 'png'\n[devices.clock]\nwrap_ticks = 256\n",
            ":3: devices.0.clock: wrap_ticks is given without tick_rate_hz",
        ),
        ("a = 1\nb =\n", ":2: not TOML"),
        ("x = 1\ny = 2\n[z]\n", ":1: x: unknown key (and 2 more)"),
    ],
)
def test_what_is_wrong_is_told_with_file_and_line(text: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        loaded(text)
    assert str(caught.value).startswith(str(FILE) + message)
    assert "\n" not in str(caught.value)


def test_a_file_that_cannot_be_read_is_one_line(tmp_path: Path) -> None:
    for read in (load, config_use.check):
        with pytest.raises(ConfigError, match=r"cannot read .*config init` makes one"):
            read(tmp_path / "rover.toml")
    (tmp_path / "rover.toml").write_bytes(b"\xff")
    with pytest.raises(ConfigError, match="cannot read"):
        load(tmp_path / "rover.toml")


def test_devices_are_constructed_with_their_settings() -> None:
    (source,) = config_use.sources_of(loaded(FULL))
    assert source.name == "depth"


@pytest.mark.parametrize(
    ("block", "message"),
    [
        ("kind = 'gyro'\nrate = 9", "kind 'gyro': unknown setting rate; did you mean rate_hz?"),
        ("kind = 'gyro'\nbaud = 9", "kind 'gyro': unknown setting baud; expected bus, chip, addr"),
        ("kind = 'gyro'\nsleep = 9", "kind 'gyro': unknown setting sleep; expected bus"),
        ("kind = 'gyro'\nrate_hz = '9'", "rate_hz: Input should be a valid number, found '9'"),
        ("kind = 'gyro'\nrate_hz = nan", "rate_hz: Input should be a finite number, found nan"),
        ("kind = 'vibration'", "kind 'vibration': port is missing"),
        ("kind = 'mocap'\nbody = 'x'\noptions = 3", "options: Input should be"),
    ],
)
def test_a_setting_that_no_driver_can_use_is_told_with_its_line(block: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        config_use.sources_of(loaded(f"[[devices]]\n{block}\n"))
    assert str(caught.value).startswith(f"{FILE}:1: devices.0: ")
    assert message in str(caught.value)


@pytest.mark.parametrize(
    "block",
    [
        "kind = 'gyro'\nrate_hz = 0.0",
        "kind = 'gyro'\naddress = 200",
        "kind = 'gyro'\ntemperature_period_s = -1.0",
        "kind = 'wheels'\nset_window_s = -1.0",
        "kind = 'wheels'\nbitrate = 0",
        "kind = 'mocap'\nbody = 'x'\nposition_sigma_m = -1.0",
        "kind = 'mocap'\nbody = 'x'\nstall_timeout_s = 0.0",
    ],
)
def test_a_number_that_makes_no_sense_is_refused_before_any_device_is_touched(block: str) -> None:
    with pytest.raises(DriverError, match="expected"):
        config_use.sources_of(loaded(f"[[devices]]\n{block}\n"))


def test_files_of_devices_are_looked_for_beside_the_configuration(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").touch()
    entry = "[[devices]]\nkind = 'vibration'\nport = 'x'\nprofile = '{}'\n"
    for profile, where in (("mine.toml", str(tmp_path)), ("wtvb01-485", "x")):
        (source,) = config_use.sources_of(loaded(entry.format(profile), tmp_path / "rover.toml"))
        with pytest.raises(DriverError, match=where):
            source.open()


def test_no_devices_are_told() -> None:
    with pytest.raises(ConfigError, match=r"no devices; add a \[\[devices\]\] block"):
        config_use.sources_of(loaded(""))


def test_a_mount_in_degrees_becomes_a_quaternion() -> None:
    (transform,) = config_use.static_transforms_of(loaded(FULL).config)
    assert (transform.parent_frame, transform.child_frame) == ("base_link", "depth_optical_frame")
    assert transform.position_m.tolist() == [0.2, 0.0, 0.35]
    # A camera that looks ahead: its z is the rover's x, its x is the rover's -y.
    assert np.allclose(transform.quat_wxyz, [0.5, -0.5, 0.5, -0.5])


def test_a_quaternion_is_taken_as_it_is() -> None:
    text = "[mounts.a]\nposition_m = [0, 0, 0]\nquaternion_wxyz = [0.6, 0.0, -0.8, 0.0]\n"
    (transform,) = config_use.static_transforms_of(loaded(text).config)
    assert transform.quat_wxyz.tolist() == [0.6, 0.0, -0.8, 0.0]


def test_the_plan_is_what_the_file_says() -> None:
    plan = config_use.plan_of(loaded(FULL), config_use.sources_of(loaded(FULL)))
    assert plan.require_all
    assert plan.flush_interval_s == 0.02
    assert plan.depth_format == "rvl"
    assert plan.worker.queue_limit_bytes == 8_000_000
    assert plan.rates_hz == {DepthFrame: 30.0}
    assert len(plan.static_transforms) == 1


def test_the_clock_of_a_device_is_tuned_and_recorded() -> None:
    clock = "[devices.clock]\ntick_rate_hz = 60e6\nwrap_ticks = 4294967296\nmax_drift_ppm = 9e3\n"
    own = loaded(FULL.replace("[mounts", clock + "min_delay_ms = 8.5\n[mounts", 1))
    plan = config_use.plan_of(own, config_use.sources_of(own))
    expected = ClockTuning(60e6, 1 << 32, max_drift_ppm=9e3, min_delay_ns=8_500_000)
    assert plan.clocks == {"depth": expected}
    assert plan.settings["device_clocks"] == {"depth": asdict(expected)}


def test_the_recording_keeps_everything_and_mapping_finds_it(tmp_path: Path) -> None:
    (tmp_path / "noise.json").write_text('{"model": {"name": "mine"}}')
    (tmp_path / "plate.json").write_text('{"plate": 1}')
    calibration = "[calibration]\ndepth_noise = 'noise.json'\nothers = ['plate.json']\n"
    settings = config_use.resolved(loaded(FULL + calibration, tmp_path / "rover.toml"))
    text = json.dumps(settings)
    found = recorded_settings({"terravibe": {"settings": text}})
    assert found["depth_noise"] == {"model": {"name": "mine"}}
    assert found["calibration_files"] == {"plate.json": {"plate": 1}}
    assert found["mount_sigma_m"] == 0.002
    assert found["mount_sigma_rad"] == pytest.approx(math.radians(0.5))
    assert found["recording"]["sync_s"] == 1.0
    assert found["devices"][0]["rate_hz"] == 30.0


def test_output_and_name(tmp_path: Path) -> None:
    disk, ring = loaded("", tmp_path / "r.toml"), loaded("[recording]\nring_s = 60.0\n")
    path = config_use.recording_path(disk, 1_709_287_812_000_000_000)
    assert path == tmp_path / "rover_20240301T101012Z.mcap"
    assert isinstance(config_use.output_of(disk, path), DiskOutput)
    output = config_use.output_of(ring, path)
    assert isinstance(output, RingOutput)
    assert output.close() == ()


def test_a_vehicle_without_a_clock_does_not_reuse_a_name(tmp_path: Path) -> None:
    config = loaded("", tmp_path / "r.toml")
    (tmp_path / "rover_19700101T000001Z_001.mcap").touch()
    second = config_use.recording_path(config, 10**9)
    assert second.name == "rover_19700101T000001Z-2.mcap"
    second.touch()
    assert config_use.recording_path(config, 10**9).name == "rover_19700101T000001Z-3.mcap"


def test_check_tells_everything_at_once(tmp_path: Path) -> None:
    path = tmp_path / "rover.toml"
    path.write_text("[recording]\nfolder = 'data'\n[calibration]\nothers = ['x.json']\n")
    found = config_use.check(path)
    assert len(found) == 3
    assert "no devices" in found[0]
    assert f"{path}:3: calibration: cannot use calibration file x.json" in found[1]
    assert f"{path}:2: recording.folder: there is no folder" in found[2]
    twice = "[[devices]]\nkind = 'gyro'\nrate = 1\n[[devices]]\nkind = 'wheels'\nbaud = 1\n"
    mounted = (
        "[mounts.depth_optical_frmae]\nposition_m = [0, 0, 0]\nquaternion_wxyz = [1, 0, 0, 0]\n"
    )
    path.write_text(twice + mounted)
    for line, words in zip(
        config_use.check(path), ("rate_hz?", "baud; expected", "depth_optical_frame?"), strict=True
    ):
        assert words in line
    path.write_text("[recording]\nfolder = 1\nflush = 3\n[[devices]]\nname = 'a'\n")
    for line, words in zip(config_use.check(path), ("folder", "flush", "kind"), strict=True):
        assert words in line
    gyro = "[[devices]]\nkind = 'gyro'\n"
    path.write_text(f"{gyro}{gyro}{gyro}rate_hz = 0.0\n{gyro}rate = 1\nchip = 3\n")
    for line, words in zip(
        config_use.check(path),
        (":3: devices.1: another device is called", ":5: devices.2: ", ":8: ", "chip: Input"),
        strict=True,
    ):
        assert words in line
    path.write_text(FULL)
    assert config_use.check(path) == []


def test_a_recording_may_stand_for_devices() -> None:
    entry = '[[devices]]\nkind = "replay"\nname = "again"\npath = "run.mcap"\nspeed = 0.0\n'
    (source,) = config_use.sources_of(loaded(entry))
    assert isinstance(source, Replay)
    assert source.name == "again"


def test_a_profile_that_does_not_exist_is_found_before_the_drive(tmp_path: Path) -> None:
    path = tmp_path / "rover.toml"
    sensor = "[[devices]]\nkind = 'vibration'\nport = 'x'\nprofile = 'wtvb01_485'\n"
    path.write_text("# mine\n" + sensor)
    (line,) = config_use.check(path)
    assert line.startswith(f"{path}:2: devices.0: no vibration profile 'wtvb01_485' (No such file")
