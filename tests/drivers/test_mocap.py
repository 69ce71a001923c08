"""Motion capture through the library's own mock, and through a stub that hangs and crashes."""

from __future__ import annotations

import importlib.util
import math
import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import DriverError
from drivers.mocap.motion_capture import MotionCapture
from drivers.samples import PoseSample
from drivers.source import OpenSource, make_source
from tests.fakes.fake_time import FakeTime

STUB = Path(__file__).parents[1] / "fakes" / "motioncapture_stub"
HALF = math.sqrt(0.5)
MOCK_BODIES = {
    "rigid_bodies": f"lander(0,0,0,1,0,0,0);rover(1.5,-2,0.25,{HALF},0,0,{HALF})",
    "frequency": 200,
}

needs_library = pytest.mark.skipif(
    importlib.util.find_spec("motioncapture") is None, reason="motioncapture is not installed"
)


def mock(body: str, **settings: object) -> MotionCapture:
    source = make_source("mocap", body=body, system="mock", **settings)
    assert isinstance(source, MotionCapture)
    return source


MakeStub = Callable[..., MotionCapture]


@pytest.fixture
def make_stub(monkeypatch: pytest.MonkeyPatch) -> MakeStub:
    """Make a driver whose child process finds the stub instead of the library."""
    monkeypatch.setenv("PYTHONPATH", str(STUB))
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())

    def make(
        options: dict[str, object],
        *,
        clock: Callable[[], int] = time.monotonic_ns,
        open_timeout_s: float = 10.0,
    ) -> MotionCapture:
        return MotionCapture(
            "rover",
            system="stub",
            options={"then": "hang", **options},
            clock=clock,
            open_timeout_s=open_timeout_s,
        )

    return make


def read_poses(mocap: MotionCapture, count: int) -> list[PoseSample]:
    poses: list[PoseSample] = []
    while len(poses) < count:
        poses += mocap.read(1.0)
    return poses


@needs_library
def test_poses_of_the_librarys_mock() -> None:
    mocap = mock("rover", options=MOCK_BODIES, position_sigma_m=0.002, rotation_sigma_rad=0.01)
    before_ns = time.monotonic_ns()
    with OpenSource(mocap) as source:
        assert source.info is not None
        assert source.info.produces == (PoseSample,)
        poses = read_poses(mocap, 5)
    assert [p.sequence for p in poses] == list(range(len(poses)))
    stamps_ns = [p.t_ns for p in poses]
    assert stamps_ns == sorted(stamps_ns)
    assert before_ns < stamps_ns[0] <= stamps_ns[-1] < time.monotonic_ns()
    pose = poses[0]
    assert pose.position_m == pytest.approx([1.5, -2.0, 0.25])
    assert pose.quat_wxyz == pytest.approx([HALF, 0.0, 0.0, HALF], abs=1e-7)
    assert np.linalg.norm(pose.quat_wxyz) == pytest.approx(1.0, abs=1e-15)
    assert np.array_equal(pose.covariance, np.diag([0.002**2] * 3 + [0.01**2] * 3))
    assert not pose.position_m.flags.writeable


@needs_library
@pytest.mark.parametrize(
    ("bodies", "sees"),
    [(MOCK_BODIES["rigid_bodies"], "lander, rover"), ("", "no rigid body at all")],
)
def test_a_body_that_is_not_seen_is_an_error_that_says_which_are(bodies: str, sees: str) -> None:
    mocap = mock("rovr", options={"rigid_bodies": bodies}, stall_timeout_s=0.05)
    with pytest.raises(DriverError, match=f"does not see rigid body 'rovr'; it sees: {sees}"):
        mocap.open()


@needs_library
def test_what_the_library_refuses_is_passed_on() -> None:
    mocap = MotionCapture("rover", system="theodolite", hostname="10.0.0.5")
    with pytest.raises(
        DriverError, match=r"mocap: theodolite at 10\.0\.0\.5: Unknown motion capture type!; check"
    ):
        mocap.open()


def test_a_missing_library_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(DriverError, match=r"pip install 'terravibe\[mocap\]'"):
        MotionCapture("rover").open()


def test_a_server_that_falls_silent_is_reported_and_close_does_not_wait(
    make_stub: MakeStub,
) -> None:
    clock = FakeTime()
    mocap = make_stub({"frames": 1}, clock=clock)  # `open` takes the only one
    with OpenSource(mocap):
        child = mocap._child
        for _ in range(2):
            assert mocap.read(0.0) == []
            clock.advance(1.1)
            with pytest.raises(DriverError, match="mocap: stub: no frames; is the server running"):
                mocap.read(0.0)
    assert child is not None
    assert child.poll() is not None


def test_read_keeps_its_time_out_while_the_library_blocks(make_stub: MakeStub) -> None:
    mocap = make_stub({"frames": 1})
    with OpenSource(mocap):
        started_s = time.monotonic()
        assert mocap.read(0.02) == []
        assert 0.02 <= time.monotonic() - started_s < 5.0


def test_a_server_that_does_not_answer_is_an_error_of_open(make_stub: MakeStub) -> None:
    mocap = make_stub({"connect": "hangs"}, open_timeout_s=0.02)
    with pytest.raises(DriverError, match="no frames; is the server running"):
        mocap.open()


@pytest.mark.parametrize("option", ["rover_frames", "rover_finite_frames"])
def test_a_body_that_disappears_is_reported(option: str, make_stub: MakeStub) -> None:
    clock = FakeTime()
    mocap = make_stub({"frames": 100_000, option: 2}, clock=clock)

    def read_on() -> None:
        while True:
            clock.advance(1.1)
            mocap.read(1.0)

    with (
        OpenSource(mocap),
        pytest.raises(DriverError, match=r"does not see rigid body 'rover'; it sees: lander$"),
    ):
        read_on()
    assert mocap.faults.lost["frames_without_body"] > 0


def test_a_crash_of_the_library_is_an_error_and_the_next_read_connects_again(
    make_stub: MakeStub,
) -> None:
    mocap = make_stub({"frames": 2, "then": "crash"})
    with OpenSource(mocap):
        for _ in range(3):
            with pytest.raises(DriverError, match="the connection ended"):
                read_poses(mocap, 100)


def test_the_child_ends_with_its_parent(make_stub: MakeStub) -> None:
    mocap = make_stub({"frames": 1})
    with OpenSource(mocap):
        child = mocap._child
        assert child is not None
        assert child.stdin is not None
        child.stdin.close()  # what the kernel does when the parent dies
        assert child.wait(30.0) == 0


def test_no_process_or_descriptor_is_left(make_stub: MakeStub) -> None:
    mocap = make_stub({"frames": 1})
    children = []
    for _ in range(5):
        mocap.open()
        assert mocap._child is not None
        children.append(mocap._child.pid)
        mocap.close()
        mocap.close()
    for pid in children:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_reading_a_closed_source_is_an_error() -> None:
    with pytest.raises(DriverError, match="mocap: not open"):
        MotionCapture("rover").read(0.0)
