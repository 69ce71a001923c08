"""Depth frames under RVL: ROS's own layout, back bit for bit, and no trust in nonsense."""

from __future__ import annotations

import errno
import io
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

import cli
from acquisition import kernel_cache
from acquisition.commands.console import Console, prepare_depth_code
from acquisition.editing.cut_and_merge import cut
from acquisition.errors import StreamError
from acquisition.inspection import check, inspect
from acquisition.messages import codec, depth_rvl
from acquisition.messages.depth_rvl import COMPRESSED_TYPE, RVL_TOPIC
from acquisition.messages.ros_types import typestore
from acquisition.messages.rvl_kernels import pack, unpack
from acquisition.replay import Replay
from acquisition.stream.writer import StreamWriter
from drivers.samples import CameraIntrinsics, DepthFrame
from tests.fakes.device_samples import with_ticks
from tests.fakes.recordings import (
    MOUNT,
    SETTINGS,
    SOURCE,
    START_NS,
    depth_frame,
    reader_of,
    recording,
    same,
    samples,
)

LEFT_OUT = codec.left_out_by("rvl")
ROW = next(row for row in codec.MESSAGE_TYPES if row.topic == RVL_TOPIC)


def frame_of(depth_mm: NDArray[np.uint16]) -> DepthFrame:
    height, width = depth_mm.shape
    return DepthFrame(START_NS, depth_mm, CameraIntrinsics(width, height, 5.0, 5.0, 1.0, 1.0), 3)


def message_of(frame: DepthFrame) -> Any:
    *_, encoded = codec.encode(frame, LEFT_OUT)
    assert encoded.topic == RVL_TOPIC
    return typestore().deserialize_cdr(encoded.cdr, COMPRESSED_TYPE)


def decoded(message: Any) -> Any:
    cdr = bytes(typestore().serialize_cdr(message, COMPRESSED_TYPE, little_endian=True))
    return codec.decode(ROW, cdr, log_time_ns=0, sequence=3)


def nibbles(text: str) -> bytes:
    """Return nibbles, in order, as little-endian words of 32 bits."""
    words = text.replace(" ", "")
    words += "0" * (-len(words) % 8)
    return b"".join(struct.pack("<I", int(words[i : i + 8], 16)) for i in range(0, len(words), 8))


# By hand, from the definition: runs 0 zeros, 2 others (+5 -> 10 = 2|8, 1; -1 -> 1); 3 zeros,
# 1 other (+996 -> 1992 = 0|8, 1|8, 7|8, 3); 2 zeros, 0 others.
PIXELS = np.array([[5, 4, 0, 0], [0, 1000, 0, 0]], dtype=np.uint16)
CODE = nibbles("0 2 a1 1  3 1 89f3  2 0")


def test_the_code_is_that_of_the_definition() -> None:
    message = message_of(frame_of(PIXELS))
    assert message.format == "16UC1; compressedDepth rvl"
    assert message.header.frame_id == "depth_optical_frame"
    assert message.data.tobytes() == bytes(12) + struct.pack("<II", 4, 2) + CODE
    assert decoded(message).depth_mm.tolist() == PIXELS.tolist()


shapes = hnp.array_shapes(min_dims=2, max_dims=2, max_side=40)
sparse = st.sampled_from([0, 0, 0, 1, 7, 8, 1000, 65535])


@given(hnp.arrays(np.uint16, shapes) | hnp.arrays(np.uint16, shapes, elements=sparse))
def test_every_image_comes_back_bit_for_bit(depth_mm: NDArray[np.uint16]) -> None:
    back = decoded(message_of(frame_of(depth_mm)))
    assert np.array_equal(back.depth_mm, depth_mm)
    assert back.depth_mm.dtype == np.uint16
    assert not back.depth_mm.flags.writeable
    assert (back.t_ns, back.sequence) == (START_NS, 3)


def test_the_worst_image_has_room() -> None:
    depth_mm = np.resize(np.array([1, 65535], dtype=np.uint16), (30, 40))
    assert np.array_equal(decoded(message_of(frame_of(depth_mm))).depth_mm, depth_mm)


@settings(max_examples=300)
@given(st.binary(max_size=64), st.integers(0, 2**32 - 1), st.integers(0, 9))
def test_nonsense_is_refused_in_one_line(code: bytes, width: int, height: int) -> None:
    message = message_of(frame_of(PIXELS))
    head = bytes(12) + struct.pack("<II", width, height)
    message.data = np.frombuffer(head + code, dtype=np.uint8)
    try:
        good = decoded(message).depth_mm.shape == (height, width)
    except StreamError as error:
        good = "\n" not in str(error)
    assert good


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"format": "16UC1; compressedDepth png"}, "expected '16UC1; compressedDepth rvl'"),
        ({"data": np.zeros(19, np.uint8)}, "19 bytes; expected whole words"),
        ({"data": np.zeros(20, np.uint8)}, "not that of 0x0 px"),
    ],
)
def test_other_formats_are_refused(change: dict[str, Any], reason: str) -> None:
    message = message_of(frame_of(PIXELS))
    for name, value in change.items():
        setattr(message, name, value)
    with pytest.raises(StreamError, match=reason):
        decoded(message)


def under_rvl(content: Any) -> bytes:
    stream = io.BytesIO()
    with StreamWriter(
        stream,
        sources=[SOURCE],
        static_transforms=[MOUNT],
        settings=SETTINGS,
        depth_format="rvl",
    ) as writer:
        for sample in content:
            writer.write(sample)
    return stream.getvalue()


def kinds(path: Path) -> set[tuple[str, str]]:
    """Return what is wrong with a recording, whatever its images are called."""
    return {(found.kind, found.topic.replace(RVL_TOPIC, "/depth/image")) for found in check(path)}


def test_a_recording_says_the_same_under_rvl(tmp_path: Path) -> None:
    content = [*samples(0.5), with_ticks(3, START_NS + 10**9)]
    path, plain = tmp_path / "r.mcap", tmp_path / "plain.mcap"
    path.write_bytes(under_rvl(content))
    plain.write_bytes(recording(content))
    found = [message.sample for message in reader_of(path.read_bytes())]
    expected = [message.sample for message in reader_of(plain.read_bytes())]
    assert len(found) == len(expected) > 20
    assert all(map(same, found, expected))
    topics = {topic.topic for topic in inspect(path).topics}
    assert RVL_TOPIC in topics
    assert "/depth/image" not in topics
    assert kinds(path) == kinds(plain)

    part = tmp_path / "part.mcap"
    cut(path, part, topics=[RVL_TOPIC])
    assert ("missing", "/depth/camera_info") in kinds(part)
    source = Replay(path, speed=0.0)
    source.open()
    frame = next(s for s in source.read(0.0) if isinstance(s, DepthFrame))
    source.close()
    assert same(replace(frame, sequence=0), replace(depth_frame(0, frame.t_ns), sequence=0))


class Notes:
    """A console that keeps what it is told beside the result."""

    def __init__(self) -> None:
        self.told: list[str] = []

    def note(self, text: str) -> None:
        self.told.append(text)


def test_a_read_only_installation_is_used_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    refused = []

    def touch(path: Path) -> None:
        refused.append(path)
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(kernel_cache, "_is_newer", lambda _: False)
    monkeypatch.setattr(Path, "touch", touch)
    depth_rvl.prepare_rvl()
    assert len(refused) >= 2


def test_only_the_first_use_compiles_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    console = Notes()
    monkeypatch.setattr(depth_rvl, "are_cached", lambda _: False)
    prepare_depth_code(cast(Console, console))
    (told,) = console.told
    assert "compiling the code for depth images" in told
    monkeypatch.undo()
    assert depth_rvl.rvl_is_cached()
    prepare_depth_code(cast(Console, console))
    assert console.told == [told]
    decoded(message_of(frame_of(np.ones((3, 4), np.uint16))))
    # What was prepared is what is used: nothing is compiled for other types of arguments.
    assert [len(kernel.signatures) for kernel in (pack, unpack)] == [1, 1]


@pytest.mark.parametrize(
    "words",
    [
        ["map", "R", "-o", "map.nc"],
        ["odometry", "R", "-o", "way.nc", "--method", "paper2019"],
        ["evaluate", "odometry", "R", "R"],
        ["calibrate", "mount", "R", "-o", "mount.toml"],
        ["calibrate", "track", "R", "--turns-deg", "90"],
        ["calibrate", "static", "--rest", "R", "-o", "static.json"],
        ["calibrate", "delay", "R", "-o", "delay.toml"],
    ],
)
def test_whoever_reads_images_first_compiles_and_says_so(
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Before the recording is read, which is none here."""
    monkeypatch.setattr(depth_rvl, "are_cached", lambda _: False)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run.mcap").write_bytes(b"no recording")
    assert cli.main(["run.mcap" if word == "R" else word for word in words]) == 2
    assert capsys.readouterr().err.count("compiling the code for depth images") == 1
