"""Recordings of other programs: unchunked, other compressions, other topics, one camera message."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from mcap.writer import CompressionType

from acquisition.errors import StreamError
from drivers.samples import DepthFrame
from tests.fakes.foreign import IMAGE, INFO, POSE, foreign, parts
from tests.fakes.recordings import START_NS, depth_frame, pose, reader_of, same

FRAMES = [depth_frame(0, START_NS + i * 10**8) for i in range(4)]


@pytest.mark.parametrize("compression", list(CompressionType))
def test_every_compression_is_read(compression: CompressionType) -> None:
    data = foreign([part for f in FRAMES for part in parts(f)], compression=compression)
    reader = reader_of(data)
    for message, frame in zip(reader, FRAMES, strict=True):
        assert same(message.sample, frame)
    assert reader.report.unprotected_messages == 0


@pytest.mark.parametrize("options", [{"use_chunking": False}, {"enable_crcs": False}])
def test_what_no_checksum_protects_is_read_and_told(options: dict[str, Any]) -> None:
    reader = reader_of(foreign(parts(pose(0)) + parts(pose(0)), **options))
    assert len(list(reader)) == 2
    assert reader.report.unprotected_messages == 2
    assert "2 messages have no checksum" in reader.report.describe()


def test_one_camera_message_serves_all_later_images() -> None:
    first, *later = FRAMES
    content = parts(first) + [part for f in later for part in parts(f, [IMAGE])]
    for message, frame in zip(reader_of(foreign(content)), FRAMES, strict=True):
        assert same(message.sample, frame)


def test_the_camera_message_may_follow_its_image() -> None:
    other = replace(FRAMES[0].camera, fx_px=99.0)
    frames = [replace(f, camera=other) if i == 2 else f for i, f in enumerate(FRAMES)]
    content = [part for f in frames for part in parts(f, [IMAGE]) + parts(f, [INFO])]
    for message, frame in zip(reader_of(foreign(content)), frames, strict=True):
        assert same(message.sample, frame)


def test_an_image_without_camera_is_told() -> None:
    with pytest.raises(StreamError, match=f"at {START_NS} ns has no camera message"):
        list(reader_of(foreign(parts(FRAMES[0], [IMAGE]) + parts(FRAMES[1], [INFO]))))


def test_a_camera_for_another_image_size_is_told() -> None:
    small = replace(FRAMES[0].camera, width_px=4)
    wrong = replace(FRAMES[0], camera=small, depth_mm=FRAMES[0].depth_mm[:, :4])
    with pytest.raises(StreamError, match="is 8x6 px but its camera message is for 4x6 px"):
        list(reader_of(foreign(parts(wrong, [INFO]) + parts(FRAMES[0], [IMAGE]))))


def test_unknown_topics_are_counted_and_known_ones_can_be_renamed() -> None:
    rename = {IMAGE: "/camera/depth/image_raw", INFO: "/camera/depth/camera_info"}
    data = foreign(parts(FRAMES[0]) + parts(pose(0)), rename)
    reader = reader_of(data)
    assert [message.topic for message in reader] == [POSE]
    assert reader.report.skipped == dict.fromkeys(rename.values(), 1)
    assert any("image_raw: 1, not used" in line for line in reader.report.describe())

    renamed = reader_of(data, topics={theirs: ours for ours, theirs in rename.items()})
    assert sorted(message.topic for message in renamed) == [IMAGE, POSE]


def test_another_encoding_is_not_mistaken_for_cdr() -> None:
    reader = reader_of(foreign(parts(pose(0)), encoding="json"))
    assert list(reader) == []
    assert reader.report.skipped == {POSE: 1}


def test_a_known_topic_with_another_type_is_skipped() -> None:
    reader = reader_of(foreign(parts(pose(0)), {POSE: IMAGE, IMAGE: POSE}))
    assert list(reader) == []
    assert reader.report.skipped == {IMAGE: 1}


def test_a_bad_message_names_topic_and_time() -> None:
    with pytest.raises(StreamError, match="bad message on /mocap/pose at 77 ns"):
        list(reader_of(foreign([(POSE, b"\x00\x01\x00\x00", 77)])))


def test_many_camera_messages_do_not_pile_up() -> None:
    reader = reader_of(foreign([p for i in range(2000) for p in parts(depth_frame(0, i), [INFO])]))
    assert list(reader) == []
    assert len(reader._pairing._cameras) == 1024


def test_frames_are_depth_frames() -> None:
    (message,) = reader_of(foreign(parts(FRAMES[0])))
    assert isinstance(message.sample, DepthFrame)
