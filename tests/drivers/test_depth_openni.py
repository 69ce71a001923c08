"""OpenNI2 in its helper process: real libOpenNI2 on generated recordings and its Dummy device."""

from __future__ import annotations

import importlib.util
import math
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.depth.openni_depth import KINECT_FOV_RAD, OpenNiDepth, intrinsics_from_fov
from drivers.depth.openni_library import find_library, has_freenect_driver, usual_folders
from drivers.errors import DriverError, EndOfSource
from drivers.samples import CameraIntrinsics, DepthFrame
from drivers.source import Source, make_source
from tests.fakes.oni_file import write_oni

STAMPS_US = [7 + 33_333 * index for index in range(90)]


@pytest.fixture
def library() -> Path:
    """Return the folder of libOpenNI2, or skip; CI demands it by an environment variable."""
    give_up = pytest.fail if os.environ.get("TERRAVIBE_REQUIRE_DEVICES") == "1" else pytest.skip
    if importlib.util.find_spec("openni") is None:
        give_up("the package openni is missing")
    try:
        return find_library(usual_folders())
    except DriverError as error:
        give_up(str(error))


def random_frames(count: int, width: int = 320, height: int = 240) -> list[np.ndarray]:
    generator = np.random.default_rng(width + count)
    return [generator.integers(0, 65536, (height, width), dtype=np.uint16) for _ in range(count)]


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Write 90 frames of 320x240."""
    path = tmp_path / "walk.oni"
    write_oni(path, random_frames(90), STAMPS_US)
    return path


@pytest.fixture
def sources() -> Iterator[Callable[..., OpenNiDepth]]:
    """Make sources and close them in the end."""
    made: list[OpenNiDepth] = []

    def make(**settings: Any) -> OpenNiDepth:
        made.append(OpenNiDepth(**settings))
        return made[-1]

    yield make
    for source in made:
        source.close()


def read_frame(source: OpenNiDepth) -> DepthFrame:
    """Return the next frame, which must come within 5 s."""
    (frame,) = source.read(5.0)
    return frame


def read_all(source: OpenNiDepth) -> list[DepthFrame]:
    frames: list[DepthFrame] = []
    while True:
        try:
            frames.extend(source.read(5.0))
        except EndOfSource:
            return frames


def helper_pid(source: OpenNiDepth) -> int:
    assert source._link is not None
    return source._link._process.pid


def refusal(source: OpenNiDepth) -> str:
    """Return the one line with which `open` refuses."""
    with pytest.raises(DriverError) as caught:
        source.open()
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("depth: ")
    with pytest.raises(DriverError, match="not open"):
        source.read(0.0)
    return str(caught.value)


@pytest.mark.usefixtures("library")
@pytest.mark.parametrize("size", [(320, 240), (640, 480)])
def test_recording_comes_back_pixel_for_pixel(
    sources: Callable[..., OpenNiDepth], tmp_path: Path, size: tuple[int, int]
) -> None:
    path = tmp_path / "walk.oni"
    written = random_frames(90, *size)
    write_oni(path, written, STAMPS_US)
    source = sources(file=path)
    info = source.open()
    assert info.time_base == "recorded"
    assert info.details["frames"] == "90"
    frames = read_all(source)
    assert [frame.sequence for frame in frames] == list(range(90))
    assert [frame.device_ticks for frame in frames] == STAMPS_US
    assert [frame.t_ns for frame in frames] == [1000 * stamp for stamp in STAMPS_US]
    for frame, expected in zip(frames, written, strict=True):
        np.testing.assert_array_equal(frame.depth_mm, expected)
    assert frames[0].depth_mm.dtype == np.uint16
    assert not frames[0].depth_mm.flags.writeable
    with pytest.raises(EndOfSource, match=r"depth: end of .*walk\.oni"):
        source.read(0.0)


@pytest.mark.usefixtures("library")
def test_decimation_takes_every_second_pixel(
    sources: Callable[..., OpenNiDepth], tmp_path: Path
) -> None:
    path = tmp_path / "walk.oni"
    written = random_frames(2, 640, 480)
    write_oni(path, written, STAMPS_US[:2], fov_rad=(1.0, 0.8))
    source = sources(file=path, decimation=2)
    assert source.open().details["intrinsics_from"] == "field of view, reported"
    frame = read_frame(source)
    np.testing.assert_array_equal(frame.depth_mm, written[0][::2, ::2])
    assert (frame.camera.width_px, frame.camera.height_px) == (320, 240)
    assert frame.camera.fx_px == pytest.approx(160 / math.tan(0.5))
    assert frame.camera.fy_px == pytest.approx(120 / math.tan(0.4))
    assert (frame.camera.cx_px, frame.camera.cy_px) == (159.75, 119.75)


@pytest.mark.usefixtures("library")
@pytest.mark.parametrize("fov_rad", [None, (0.0, 0.8), (math.nan, 0.8)])
def test_without_a_field_of_view_it_is_a_kinects(
    sources: Callable[..., OpenNiDepth], tmp_path: Path, fov_rad: tuple[float, float] | None
) -> None:
    path = tmp_path / "walk.oni"
    write_oni(path, random_frames(1), STAMPS_US[:1], fov_rad=fov_rad)
    source = sources(file=path)
    assert source.open().details["intrinsics_from"] == "field of view, Kinect V1 nominal"
    assert read_frame(source).camera == intrinsics_from_fov(320, 240, KINECT_FOV_RAD)


@pytest.mark.usefixtures("library")
def test_given_intrinsics_are_used(sources: Callable[..., OpenNiDepth], recording: Path) -> None:
    source = sources(file=recording, intrinsics_px=[290.0, 291.0, 160.0, 120.0])
    assert source.open().details["intrinsics_from"] == "settings"
    assert read_frame(source).camera == CameraIntrinsics(320, 240, 290.0, 291.0, 160.0, 120.0)


@pytest.mark.usefixtures("library")
def test_device_is_stamped_by_this_hosts_clock(sources: Callable[..., OpenNiDepth]) -> None:
    source = sources(device="Dummy", name="front")
    info = source.open()
    assert (info.name, info.model, info.time_base) == ("front", "Table Tennis", "monotonic")
    assert info.nominal_rate_hz == {DepthFrame: 30.0}
    before_ns = time.monotonic_ns()
    first, second = read_frame(source), read_frame(source)
    assert before_ns - 10**9 < first.t_ns < second.t_ns < time.monotonic_ns()
    assert (first.sequence, second.sequence) == (0, 1)
    assert first.device_ticks is not None
    assert second.device_ticks == first.device_ticks + 33_000  # the Dummy's own counting
    assert first.depth_mm.shape == (240, 320)
    assert first.depth_mm.any()


@pytest.mark.usefixtures("library")
def test_read_returns_in_time(sources: Callable[..., OpenNiDepth]) -> None:
    source = sources(device="Dummy")
    source.open()
    read_frame(source)
    start_s = time.monotonic()
    assert source.read(0.0) == []
    assert time.monotonic() - start_s < 0.02


@pytest.mark.usefixtures("library")
def test_life_of_a_source(sources: Callable[..., OpenNiDepth], recording: Path) -> None:
    source = sources(file=recording)
    source.close()
    with pytest.raises(DriverError, match=r"depth is not open; call open\(\)"):
        source.read(0.0)
    source.open()
    read_frame(source)
    first_pid = helper_pid(source)
    source.open()  # starts again
    assert not Path(f"/proc/{first_pid}").exists()
    assert len(read_all(source)) == 90
    source.close()
    source.close()


@pytest.mark.usefixtures("library")
@pytest.mark.parametrize("name", ["SIGKILL", "SIGSEGV", "SIGABRT"])
def test_a_crash_is_an_error_and_open_recovers(
    sources: Callable[..., OpenNiDepth], name: str
) -> None:
    source = sources(device="Dummy")
    source.open()
    read_frame(source)
    pid = helper_pid(source)
    os.kill(pid, signal.Signals[name])
    with pytest.raises(DriverError, match=rf"depth: Dummy lost its helper .*ended by {name}"):
        read_all(source)
    with pytest.raises(DriverError, match="not open"):
        source.read(0.0)
    assert not Path(f"/proc/{pid}").exists()
    source.open()
    assert read_frame(source).sequence == 0


@pytest.mark.usefixtures("library")
def test_a_hang_is_an_error_and_open_recovers(sources: Callable[..., OpenNiDepth]) -> None:
    source = sources(device="Dummy", stall_s=1.0)
    source.open()
    read_frame(source)
    pid = helper_pid(source)
    os.kill(pid, signal.SIGSTOP)
    with pytest.raises(DriverError, match=r"depth: Dummy hangs in libOpenNI2 for more than 1 s"):
        read_all(source)
    assert not Path(f"/proc/{pid}").exists()
    source.open()
    read_frame(source)


@pytest.mark.usefixtures("library")
def test_open_gives_up_in_time(
    sources: Callable[..., OpenNiDepth], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    mute = tmp_path / "python"
    mute.write_text("#!/bin/sh\nexec sleep 100\n")
    mute.chmod(0o700)
    monkeypatch.setattr(sys, "executable", str(mute))
    start_s = time.monotonic()
    message = refusal(sources(device="Dummy", open_timeout_s=0.05))
    assert "depth: Dummy did not open within 0.05 s" in message
    assert time.monotonic() - start_s < 1.0


def test_a_helper_that_cannot_start(
    sources: Callable[..., OpenNiDepth],
    recording: Path,
    library: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys, "executable", "/nonexistent/python")
    assert "helper process that cannot be started" in refusal(sources(file=recording))


@pytest.mark.usefixtures("library")
def test_a_recording_that_is_cut_off(sources: Callable[..., OpenNiDepth], recording: Path) -> None:
    whole = recording.read_bytes()
    recording.write_bytes(whole[: len(whole) // 2])
    source = sources(file=recording, silence_s=1.0)
    source.open()
    with pytest.raises(DriverError, match=r"walk\.oni ends after 44 frames; expected 90.*copy it"):
        read_all(source)


@pytest.mark.usefixtures("library")
@pytest.mark.parametrize("seed", range(8))
def test_a_damaged_recording_never_takes_the_caller_down(
    sources: Callable[..., OpenNiDepth], tmp_path: Path, seed: int
) -> None:
    path = tmp_path / "damaged.oni"
    write_oni(path, random_frames(3, 32, 24), STAMPS_US[:3])
    data = bytearray(path.read_bytes())
    generator = np.random.default_rng(seed)
    for position in generator.integers(4, 500, 20):  # the records before the first frame
        data[position] = generator.integers(256)
    path.write_bytes(data)
    source = sources(file=path, silence_s=0.3, stall_s=0.5, open_timeout_s=3.0)
    try:
        source.open()
        read_all(source)
    except DriverError as error:
        assert "damaged.oni" in str(error)  # noqa: PT017 - a damage that does not matter is fine


@pytest.mark.usefixtures("library")
def test_a_crash_inside_the_library_leaves_the_caller_alive(
    sources: Callable[..., OpenNiDepth], recording: Path
) -> None:
    # OpenNI 2.2.0.33 crashes on a property's name with a byte above 127.
    recording.write_bytes(recording.read_bytes().replace(b"oniPixelFormat", b"oniPixelForm\xe4t"))
    message = refusal(sources(file=recording))
    assert "walk.oni lost its helper process (ended by SIGSEGV)" in message
    assert "the recording is probably damaged" in message


@pytest.mark.usefixtures("library")
def test_a_recording_that_was_never_closed(
    sources: Callable[..., OpenNiDepth], recording: Path
) -> None:
    data = bytearray(recording.read_bytes())
    position = data.index(b"NONE") + 4  # the number of frames is behind the codec
    data[position : position + 4] = b"\xff" * 4
    recording.write_bytes(data[:-100])
    source = sources(file=recording, silence_s=1.0)
    assert "frames" not in source.open().details
    with pytest.raises(DriverError, match=r"ends after 89 frames; expected an end mark"):
        read_all(source)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "cannot read "),
        (b"", "starts with b''; expected b'NI10'"),
        (b"\x89PNG....", "expected b'NI10', an OpenNI recording"),
    ],
)
def test_not_a_recording(
    sources: Callable[..., OpenNiDepth], tmp_path: Path, content: bytes | None, message: str
) -> None:
    path = tmp_path / "file.oni"
    if content is not None:
        path.write_bytes(content)
    assert message in refusal(sources(file=path))


@pytest.mark.usefixtures("library")
def test_a_recording_that_the_library_refuses(
    sources: Callable[..., OpenNiDepth], tmp_path: Path
) -> None:
    path = tmp_path / "file.oni"
    path.write_bytes(b"NI10" + bytes(100))
    assert "file.oni is refused by OpenNI2: " in refusal(sources(file=path))


@pytest.mark.usefixtures("library")
def test_no_camera(sources: Callable[..., OpenNiDepth], library: Path) -> None:
    if has_freenect_driver(library):
        pytest.skip("FreenectDriver is installed here")
    message = refusal(sources())
    assert "depth camera is not found by OpenNI2" in message
    assert "libfreenect (cmake -DBUILD_OPENNI2_DRIVER=ON)" in message
    assert "nowhere is refused by OpenNI2" in refusal(sources(device="nowhere"))


def test_missing_libraries_are_named(
    sources: Callable[..., OpenNiDepth],
    tmp_path: Path,
    recording: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _name: None)
    assert "pip install 'terravibe[kinect]'" in refusal(sources(file=recording))
    monkeypatch.setattr(importlib.util, "find_spec", lambda _name: object())
    source = sources(file=recording, library_folder=tmp_path)
    assert "apt install libopenni2-0 libopenni2-dev" in refusal(source)
    (tmp_path / "libOpenNI2.so.0").touch()
    assert "but not the link libOpenNI2.so" in refusal(source)


@pytest.mark.usefixtures("library")
def test_a_library_that_does_not_load(
    sources: Callable[..., OpenNiDepth], tmp_path: Path, recording: Path
) -> None:
    (tmp_path / "libOpenNI2.so").write_text("not a library")
    source = sources(file=recording, library_folder=tmp_path)
    assert "failed with InitializationError: OpenNI2 could not be loaded" in refusal(source)


def test_the_environment_names_the_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("OPENNI2_REDIST64", str(tmp_path))
    assert usual_folders() == [tmp_path]
    (tmp_path / "libOpenNI2.so").touch()
    assert find_library(usual_folders()) == tmp_path
    assert not has_freenect_driver(tmp_path)
    drivers = tmp_path / "OpenNI2" / "Drivers"
    drivers.mkdir(parents=True)
    (drivers / "libFreenectDriver.so.0").touch()
    assert has_freenect_driver(tmp_path)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"decimation": 3}, "depth: decimation is 3; expected 1 or 2"),
        ({"device": "Dummy", "file": "a.oni"}, "expected one of them"),
        ({"silence_s": 0.0}, "silence_s is 0.0"),
        ({"stall_s": float("nan")}, "stall_s is nan"),
        ({"open_timeout_s": -1.0}, "open_timeout_s is -1.0"),
        ({"intrinsics_px": (0.0, 1.0, 1.0, 1.0)}, "fx of intrinsics_px is 0.0"),
    ],
)
def test_settings_are_checked(
    sources: Callable[..., OpenNiDepth], settings: dict[str, Any], message: str
) -> None:
    assert message in refusal(sources(**settings))


@pytest.mark.usefixtures("library")
def test_helper_is_out_of_reach_of_ctrl_c(sources: Callable[..., OpenNiDepth]) -> None:
    source = sources(device="Dummy")
    source.open()
    assert os.getsid(helper_pid(source)) != os.getsid(0)


@pytest.mark.usefixtures("library")
def test_helper_ends_when_the_recorder_is_killed() -> None:
    script = (
        "import os, signal; from drivers.depth.openni_depth import OpenNiDepth;"
        "source = OpenNiDepth(device='Dummy'); source.open();"
        "print(source._link._process.pid, flush=True); signal.pause()"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, text=True, env=environment
    ) as recorder:
        assert recorder.stdout is not None
        helper = os.pidfd_open(int(recorder.stdout.readline()))
        recorder.kill()
    try:
        ended, _, _ = select.select([helper], [], [], 5.0)
        assert ended
    finally:
        os.close(helper)


def test_kind_is_in_the_table(recording: Path) -> None:
    source: Source = make_source("openni", file=str(recording))
    assert isinstance(source, OpenNiDepth)
    assert source.name == "depth"
