"""What a run has to say of a recording that makes less of a map than it seems."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest

from acquisition.stream.writer import StreamWriter
from drivers.samples import CameraIntrinsics, DepthFrame, PoseSample, Sample
from drivers.source import SourceInfo
from mapping.calibration_file import DeviceIdentity
from mapping.errors import MappingError
from mapping.output.map_summary import RunSummary, summarise_run
from mapping.recorded import depth_devices
from mapping.session import MapOptions, MapResult, map_stream
from mapping.settings import MapSettings
from tests.fakes.recordings import reader_of
from tests.mapping.scenes import CAMERA, floor_frame, mount, pose_sample

SOURCE = SourceInfo("fake", "floor", "A1", (PoseSample, DepthFrame), "recorded")
NARROW = replace(CAMERA, fx_px=70.0, fy_px=70.0)
SMALL = CameraIntrinsics(32, 24, 29.0, 29.0, 15.5, 11.5)


def _map(cameras: Sequence[CameraIntrinsics], **settings: Any) -> MapResult:
    """Map one frame of each camera, seen from one place."""
    stream = io.BytesIO()
    with StreamWriter(
        stream, sources=[SOURCE], static_transforms=mount().transforms, settings={}
    ) as writer:
        for n, camera in enumerate(cameras):
            samples: list[Sample] = [pose_sample(n * 10**8), floor_frame(n * 10**8, camera=camera)]
            for sample in samples:
                writer.write(sample)
    return map_stream(reader_of(stream.getvalue()), MapOptions(MapSettings(**settings)))


def _told(result: MapResult) -> RunSummary:
    return summarise_run(result, "map.nc")


def test_a_single_frame_confirms_nothing_and_claims_nothing() -> None:
    told = _told(_map([CAMERA]))
    (warning,) = told.warnings
    assert warning.startswith("no cell is confirmed, which takes 2 frames and 4 readings of it")
    assert "  no height is confirmed" in told.describe()
    assert "sigma" not in "".join(told.describe())
    assert json.loads(json.dumps(told.as_json()))["map"]["sigma_median_m"] is None
    assert _told(_map([CAMERA] * 2)).warnings == ()


def test_a_window_that_takes_the_lesser_part_is_told() -> None:
    (warning,) = _told(_map([CAMERA] * 2, grid="scrolling", window_m=1.6)).warnings
    assert "readings fell outside the window of 1.6 m around the rover" in warning


@pytest.mark.parametrize(
    ("cameras", "changes"),
    [
        ([CAMERA] * 3 + [NARROW] * 3, 1),
        ([CAMERA, CAMERA, SMALL, SMALL, CAMERA], 2),
        ([CAMERA, NARROW] * 3, 5),
    ],
)
def test_intrinsics_that_change_are_told(cameras: list[CameraIntrinsics], changes: int) -> None:
    result = _map(cameras)
    assert result.counts.frames == len(cameras)
    (warning,) = _told(result).warnings
    assert f"the depth camera's intrinsics changed {changes} times" in warning
    assert "if it is not one camera, map the recording of each camera by itself" in warning


def test_two_depth_cameras_of_a_merged_recording_are_told() -> None:
    source = {"model": "kinect", "produces": ["DepthFrame"]}
    records = {
        name: {"source.depth": json.dumps(source | {"serial": serial})}
        for name, serial in (
            ("terravibe", "A1"),
            ("terravibe (b.mcap)", "B2"),
            ("terravibe (c.mcap)", "A1"),
            ("terravibe_merge", "C3"),
        )
    } | {"terravibe (gyro.mcap)": {"settings": "{}"}}
    devices = depth_devices(records)
    assert [device.serial for device in devices] == ["A1", "B2"]
    result = _map([CAMERA] * 2)
    assert result.depth_devices == (DeviceIdentity(model="floor", serial="A1"),)
    (warning,) = _told(replace(result, depth_devices=devices)).warnings
    assert "has 2 depth cameras (kinect A1, kinect B2), mapped with one mount and one n" in warning


def test_a_second_mount_and_another_depth_topic_are_told() -> None:
    result = _map([CAMERA] * 2)
    counts = replace(result.counts, mounts_replaced=1)
    report = replace(result.report, skipped={"/depth2/image": 7, "/rosout": 9})
    first, second = _told(replace(result, counts=counts, report=report)).warnings
    assert first.startswith("1 mounts of /tf_static were given again with other numbers")
    assert second == (
        "7 messages of /depth2/image are not mapped; depth is read from /depth/image alone"
    )


def test_a_recording_without_depth_says_where_to_look() -> None:
    with pytest.raises(MappingError, match=r"holds no depth frame; .* see `terravibe info`"):
        _map([])
