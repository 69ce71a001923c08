"""What OpenNI2's driver is made of: the link to the helper, intrinsics, and ticks."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.depth.openni_depth import (
    KINECT_FOV_RAD,
    decimated,
    intrinsics_from_fov,
)
from drivers.depth.openni_helper import ParentLink
from drivers.depth.openni_protocol import (
    SLOTS,
    End,
    Failure,
    FrameNote,
    HelperSettings,
    Message,
    Ready,
    decode,
    encode,
)
from drivers.samples import CameraIntrinsics


@pytest.fixture
def parent_link() -> Iterator[tuple[ParentLink, socket.socket]]:
    """Connect the helper's side of the link to a socket of this test."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    memory_fd = os.memfd_create("test")
    link = ParentLink(HelperSettings(theirs.detach(), memory_fd, "", "", False, 1.0))
    link.announce(Ready("", "", "", 4, 2, 30, None, None))
    yield link, ours
    link._socket.close()
    link._memory.close()
    ours.close()
    os.close(memory_fd)


def test_live_frames_are_dropped_when_the_parent_is_slow(
    parent_link: tuple[ParentLink, socket.socket],
) -> None:
    link, _ = parent_link
    assert [link.free_slot(wait=False) for _ in range(SLOTS)] == list(range(SLOTS))
    assert link.free_slot(wait=False) is None


def test_a_recording_waits_for_a_slot_until_the_stop(
    parent_link: tuple[ParentLink, socket.socket],
) -> None:
    link, _ = parent_link
    for _ in range(SLOTS):
        link.free_slot(wait=True)
    link.stopping.set()
    assert link.free_slot(wait=True) is None


@pytest.mark.parametrize(
    "message",
    [
        Ready("Microsoft", "Kinect", "freenect://0", 640, 480, 30, [1.0, 0.8], None),
        FrameNote(3, 10**18, 2**40, 7),
        End(),
        Failure("is gone"),
    ],
)
def test_messages_survive_the_socket(message: Message) -> None:
    assert decode(encode(message)) == message


def test_kinect_intrinsics() -> None:
    # 320 / tan(0.5105) and 240 / tan(0.39795); calibrations of Kinect V1 are around 580.
    camera = intrinsics_from_fov(640, 480, KINECT_FOV_RAD)
    assert camera.fx_px == pytest.approx(571.4, abs=0.1)
    assert camera.fy_px == pytest.approx(570.9, abs=0.1)
    assert (camera.cx_px, camera.cy_px) == (319.5, 239.5)


@given(x=st.floats(-1, 1), y=st.floats(-1, 1), z=st.floats(0.5, 10), width=st.integers(2, 641))
def test_decimated_intrinsics_see_the_same_point(x: float, y: float, z: float, width: int) -> None:
    full = CameraIntrinsics(width, 480, 580.0, 581.0, 315.0, 242.0)
    half = decimated(full, 2)
    assert half.width_px == len(range(0, width, 2))
    u, v = full.fx_px * x / z + full.cx_px, full.fy_px * y / z + full.cy_px
    assert 2 * (half.fx_px * x / z + half.cx_px) == pytest.approx(u)
    assert 2 * (half.fy_px * y / z + half.cy_px) == pytest.approx(v)
