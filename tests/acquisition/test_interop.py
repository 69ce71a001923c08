"""A recording of ours in other programs' hands."""

from __future__ import annotations

import io
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

from drivers.samples import DepthFrame
from tests.fakes.recordings import CAMERA, recording, samples

SAMPLES = samples(0.3)
FRAMES = [sample for sample in SAMPLES if isinstance(sample, DepthFrame)]
MESSAGES = len(SAMPLES) + len(FRAMES) + 1  # a camera message with every frame, and /tf_static


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "ours.mcap"
    file.write_bytes(recording(SAMPLES))
    return file


@pytest.mark.parametrize("kind", [make_reader, NonSeekingReader])
def test_mcap_reads_it_with_every_checksum(kind: Any) -> None:
    reader = kind(io.BytesIO(recording(SAMPLES)), validate_crcs=True)
    messages = list(reader.iter_messages())
    assert len(messages) == MESSAGES
    assert {schema.encoding for schema, _, _ in messages} == {"ros2msg"}
    assert [m.sequence for _, c, m in messages if c.topic == "/depth/image"] == [
        frame.sequence for frame in FRAMES
    ]


def test_rosbags_reads_it(path: Path) -> None:
    with Reader(path) as reader:
        assert reader.message_count == MESSAGES
        assert len(list(reader.messages())) == MESSAGES


def test_rosbags_decodes_it_by_the_schemas_inside(path: Path) -> None:
    found: dict[str, list[Any]] = {}
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            found.setdefault(connection.topic, []).append(message)
    for message, frame in zip(found["/depth/image"], FRAMES, strict=True):
        pixels = message.data.view("<u2").reshape(message.height, message.width)
        assert np.array_equal(pixels, frame.depth_mm)
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == frame.t_ns
        assert (message.encoding, message.header.frame_id) == ("16UC1", "depth_optical_frame")
    camera = found["/depth/camera_info"][0]
    assert (camera.k[0], camera.k[4]) == (CAMERA.fx_px, CAMERA.fy_px)
    assert (camera.k[2], camera.k[5]) == (CAMERA.cx_px, CAMERA.cy_px)
    (transform,) = found["/tf_static"][0].transforms
    assert transform.header.frame_id == "mocap_body"
    assert transform.transform.rotation.y == -0.8


@pytest.fixture
def rerun() -> str:
    """Return the rerun program, or skip; where interoperation is required, fail."""
    program = shutil.which("rerun") or shutil.which("rerun", path=Path(sys.executable).parent)
    if program is None:
        reason = "no `rerun` program; pip install 'terravibe[interop]'"
        if os.environ.get("TERRAVIBE_REQUIRE_INTEROP") == "1":
            pytest.fail(reason)
        pytest.skip(reason)
    return program


def output_of(*command: str | Path) -> str:
    # CI: rerun sends no usage statistics then.
    environment = {**os.environ, "CI": "true"}
    finished = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=120, check=False
    )
    assert finished.returncode == 0, finished.stderr
    return finished.stdout


def test_rerun_shows_depth_camera_and_frames(rerun: str, path: Path) -> None:
    converted = path.with_suffix(".rrd")
    output_of(rerun, "mcap", "convert", path, "-o", converted)
    lines = output_of(rerun, "rrd", "print", converted).splitlines()

    def shown(entity: str, component: str) -> bool:
        return any(f" - {entity} - " in line and component in line for line in lines)

    assert shown("/depth/image", "DepthImage:buffer")
    assert shown("/depth/camera_info", "Pinhole:image_from_camera")
    assert shown("/tf_static", "Transform3D:quaternion")
