"""Samples in, map out: which frames are mapped, when, and what is said when none can be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from acquisition.messages.frames import StaticTransforms
from drivers.samples import AccelerationSample, CameraIntrinsics, Sample, frozen_array
from mapping.errors import MappingError
from mapping.judging.evaluation import CONFIRMED
from mapping.mapper import Mapper
from mapping.noise import NGUYEN_2012, DepthNoiseModel
from mapping.settings import MapSettings
from tests.mapping.scenes import CAMERA, floor_frame, looking, mount, pose_sample

SECOND_NS = 1_000_000_000
TENTH_NS = SECOND_NS // 10


def _mapper(*samples: Sample | StaticTransforms, mounted: bool = True) -> Mapper:
    mapper = Mapper(MapSettings(resolution_m=0.05), NGUYEN_2012)
    if mounted:
        mapper.add(mount())
    for sample in samples:
        mapper.add(sample)
    return mapper


def _pairs(count: int) -> list[Sample]:
    """Return poses and frames of a camera at rest, ten a second."""
    samples: list[Sample] = []
    for n in range(count):
        samples += [pose_sample(n * TENTH_NS), floor_frame(n * TENTH_NS)]
    return samples


def test_a_floor_is_mapped_at_its_height() -> None:
    mapper = _mapper(*_pairs(5))
    map_ = mapper.elevation_map()
    confirmed = np.isin(map_.state, CONFIRMED)
    assert confirmed.sum() > 200
    # Millimetres of depth: half a millimetre along the ray is less in height.
    assert np.abs(map_.elevation_m[confirmed]).max() < 0.0006
    counts = mapper.counts
    assert (counts.frames, counts.poses, counts.frames_without_pose) == (5, 5, 0)
    assert counts.readings > 5 * 1000
    assert (counts.readings_outside, counts.rejected, counts.replaced) == (0, 0, 0)
    assert counts.updates == map_.frames.sum()
    assert counts.readings == map_.pixels.sum()
    assert (map_.last_seen_ns[map_.known] <= 4 * TENTH_NS).all()


def test_a_frame_between_two_poses_is_seen_from_in_between() -> None:
    """The camera rises 0.1 m and turns 20 degrees in 0.2 s; the frame is taken half way."""
    ends = looking(0.0), looking(20.0)
    mapper = _mapper(
        pose_sample(0, (0.0, 0.0, 0.4), ends[0]),
        floor_frame(TENTH_NS, 0.45, looking(10.0)),
        pose_sample(2 * TENTH_NS, (0.2, 0.0, 0.5), ends[1]),
    )
    found = mapper.elevation_map()
    expected = _mapper(
        pose_sample(TENTH_NS, (0.1, 0.0, 0.45), looking(10.0)),
        floor_frame(TENTH_NS, 0.45, looking(10.0)),
    ).elevation_map()
    np.testing.assert_allclose(found.x_m, expected.x_m)
    same = (found.pixels == expected.pixels) & found.known
    assert same.sum() > 0.95 * expected.known.sum()  # a reading on a border may change sides
    difference = found.elevation_m[same] - expected.elevation_m[same]
    np.testing.assert_allclose(difference, 0.0, atol=1e-5)


def test_the_mount_says_where_the_camera_is_on_the_body() -> None:
    """A body at another place and attitude, with the camera mounted so that it is where it was."""
    camera = looking(), np.array([0.0, 0.0, 0.4])
    body = Rotation.from_euler("ZYX", [70.0, 10.0, -5.0], degrees=True)
    body_m = np.array([-0.3, 0.2, 0.9])
    turn = body.inv() * Rotation.from_matrix(camera[0])
    transforms = mount(body.inv().apply(camera[1] - body_m), turn.as_quat(scalar_first=True))
    found = _mapper(
        transforms,
        pose_sample(0, body_m, body.as_matrix()),
        floor_frame(0),
        mounted=False,
    ).elevation_map()
    expected = _mapper(*_pairs(1)).elevation_map()
    same = (found.pixels == expected.pixels) & found.known
    assert same.sum() > 0.95 * expected.known.sum()
    difference = found.elevation_m[same] - expected.elevation_m[same]
    np.testing.assert_allclose(difference, 0.0, atol=1e-5)


def test_a_frame_waits_for_the_pose_that_follows_it() -> None:
    mapper = _mapper(pose_sample(0), floor_frame(TENTH_NS))
    assert mapper.counts.frames == 0
    mapper.add(pose_sample(2 * TENTH_NS))
    assert mapper.counts.frames == 1


def test_it_makes_no_difference_which_of_pose_and_frame_comes_first() -> None:
    samples = _pairs(4)
    swapped = [samples[i ^ 1] for i in range(len(samples))]
    first, second = _mapper(*samples), _mapper(*swapped)
    assert first.elevation_map().sha256() == second.elevation_map().sha256()
    assert first.counts == second.counts


def test_frames_wait_two_seconds_of_stream_time_at_most() -> None:
    mapper = _mapper()
    for n in range(100):
        mapper.add(floor_frame(n * TENTH_NS))
        assert len(mapper._waiting) <= 21
    assert mapper.counts.frames_without_pose == 79
    # Any sample tells how far the stream is.
    still = AccelerationSample(12 * SECOND_NS, frozen_array((0.0, 0.0, 9.8), (3,)), 0)
    mapper.add(still)
    assert mapper.counts.frames_without_pose == 100
    assert not mapper._waiting


def test_a_frame_from_the_future_holds_up_no_other() -> None:
    samples = _pairs(30)
    samples.insert(3, floor_frame(999 * SECOND_NS))
    mapper = _mapper(*samples)
    assert mapper.counts.frames == 30
    assert len(mapper._waiting) == 1
    mapper.finish()
    assert mapper.counts.frames_without_pose == 1
    assert mapper.elevation_map().sha256() == _mapper(*_pairs(30)).elevation_map().sha256()


def test_frames_without_a_pose_are_counted_not_mapped() -> None:
    late = [floor_frame(n * TENTH_NS) for n in (1, 7, 13)]  # before, in a gap, behind
    poses = [pose_sample(n * TENTH_NS) for n in (2, 3, 10, 11)]
    stream: list[Sample] = [*late, *poses, floor_frame(3 * TENTH_NS)]
    mapper = _mapper(*sorted(stream, key=lambda sample: sample.t_ns))
    mapper.finish()
    assert (mapper.counts.frames, mapper.counts.frames_without_pose) == (1, 3)
    mapper.finish()
    assert mapper.counts.frames_without_pose == 3


def test_poses_that_repeat_or_go_back_are_left_out() -> None:
    samples = _pairs(3)
    wrong = (9.0, 9.0, 9.0)
    samples[3:3] = [pose_sample(TENTH_NS, wrong), pose_sample(0, wrong)]
    mapper = _mapper(*samples)
    assert (mapper.counts.poses, mapper.counts.poses_out_of_order) == (3, 2)
    assert mapper.elevation_map().sha256() == _mapper(*_pairs(3)).elevation_map().sha256()


def test_the_camera_may_change_in_the_middle_of_a_stream() -> None:
    """320 px wide, then 64, then with another focal length: each frame with its own rays."""
    wide = CameraIntrinsics(320, 240, 290.0, 290.0, 159.5, 119.5)
    zoomed = replace(CAMERA, fx_px=70.0, fy_px=72.0)
    cameras = [wide, CAMERA, zoomed, wide]
    samples: list[Sample] = []
    for n, camera in enumerate(cameras):
        samples += [pose_sample(n * TENTH_NS), floor_frame(n * TENTH_NS, camera=camera)]
    mapper = _mapper(*samples)
    map_ = mapper.elevation_map()
    assert mapper.counts.frames == 4
    assert mapper.counts.readings_outside == 0
    assert mapper.counts.rejected == 0
    confirmed = np.isin(map_.state, CONFIRMED)
    assert np.abs(map_.elevation_m[confirmed]).max() < 0.0006


def test_a_map_in_between_changes_nothing() -> None:
    samples = _pairs(4)
    mapper = _mapper(*samples[:4])
    half = mapper.elevation_map()
    fingerprint = half.sha256()
    for sample in samples[4:]:
        mapper.add(sample)
    assert half.sha256() == fingerprint
    assert mapper.elevation_map().sha256() == _mapper(*samples).elevation_map().sha256()


def test_a_small_window_counts_what_it_does_not_take() -> None:
    settings = MapSettings(resolution_m=0.05, grid="scrolling", window_m=3.0)
    mapper = Mapper(settings, NGUYEN_2012)
    for sample in (mount(), *_pairs(2)):
        mapper.add(sample)
    counts, map_ = mapper.counts, mapper.elevation_map()
    assert 0 < counts.readings_outside < counts.readings
    assert map_.pixels.sum() == counts.readings - counts.readings_outside
    assert map_.x_m.max() < 1.5


def test_both_grids_make_the_same_map_while_nothing_leaves_the_window() -> None:
    scrolling = Mapper(MapSettings(resolution_m=0.05, grid="scrolling", window_m=20.0), NGUYEN_2012)
    for sample in (mount(), *_pairs(3)):
        scrolling.add(sample)
    found, expected = scrolling.elevation_map(), _mapper(*_pairs(3)).elevation_map()
    assert found.sha256() == expected.sha256()


def test_only_readings_within_both_ranges_are_mapped() -> None:
    noise = NGUYEN_2012.with_range(0.9, 3.0)
    mapper = Mapper(MapSettings(range_min_m=0.5, range_max_m=1.5), noise)
    assert (mapper.noise.range_min_m, mapper.noise.range_max_m) == (0.9, 1.5)
    for sample in (mount(), *_pairs(1)):
        mapper.add(sample)
    image_mm = floor_frame(0).depth_mm
    assert mapper.counts.readings == np.count_nonzero((image_mm >= 900) & (image_mm <= 1500))
    with pytest.raises(MappingError, match="expected ranges that overlap"):
        Mapper(MapSettings(range_min_m=3.5), noise)


def test_no_depth_no_pose_or_no_overlap_are_told_apart() -> None:
    empty = _mapper(pose_sample(0))
    empty.finish()
    with pytest.raises(MappingError, match="the stream holds no depth frame; nothing can be"):
        empty.elevation_map()
    blind = _mapper(floor_frame(0), floor_frame(TENTH_NS))
    blind.finish()
    with pytest.raises(MappingError, match="holds 2 depth frames but no pose; record motion"):
        blind.elevation_map()
    apart = _mapper(floor_frame(0), pose_sample(SECOND_NS), pose_sample(2 * SECOND_NS))
    apart.finish()
    reason = r"none of 1 depth frames lies between two of the 2 poses within 0\.2 s; check that"
    with pytest.raises(MappingError, match=reason):
        apart.elevation_map()


def test_frames_in_which_nothing_is_in_range_make_no_map() -> None:
    mapper = _mapper(pose_sample(0), floor_frame(0, 30.0))
    assert (mapper.counts.frames, mapper.counts.readings) == (1, 0)
    with pytest.raises(MappingError, match="no depth reading reached the map; check the range"):
        mapper.elevation_map()


def test_without_a_mount_nothing_is_guessed() -> None:
    with pytest.raises(MappingError, match="does not connect mocap_body with depth_optical_frame"):
        _mapper(*_pairs(1), mounted=False)


def test_a_pose_that_is_none_ends_the_run() -> None:
    broken = replace(pose_sample(5), position_m=np.array([0.0, np.nan, 0.0]))
    with pytest.raises(MappingError, match="pose at 5 ns: position is"):
        _mapper(broken)


def test_an_image_that_does_not_fit_its_camera_ends_the_run() -> None:
    """numba does not look at bounds: it would write over the end of the work array."""
    frame = replace(floor_frame(0), depth_mm=np.zeros((480, 640), np.uint16))
    with pytest.raises(MappingError, match=r"depth image is uint16 of shape \(480, 640\)"):
        _mapper(pose_sample(0), frame)


def test_a_jump_of_the_pose_is_refused_before_memory_is_gone() -> None:
    with pytest.raises(MappingError, match="check the poses for jumps"):
        _mapper(*_pairs(1), pose_sample(TENTH_NS, (5e4, 5e4, 0.4)), floor_frame(TENTH_NS))


def test_outside_its_box_a_calibration_yields_to_the_fallback() -> None:
    """The floor is seen from 0.5 to 2 m and more; the calibration covers 0.8 to 1.2 m of it."""
    near = DepthNoiseModel("rig", axial_offset_m=0.001, range_min_m=0.8, range_max_m=1.2)
    far = DepthNoiseModel("default", axial_offset_m=0.02)
    maps, counts = [], []
    for noise, fallback in ((near, None), (near, far), (far, None)):
        mapper = Mapper(MapSettings(resolution_m=0.04), noise, fallback=fallback)
        mapper.add(mount())
        for k in range(4):
            mapper.add(pose_sample(k * 10**8))
            mapper.add(floor_frame(k * 10**8))
        maps.append(mapper.elevation_map())
        counts.append(mapper.counts)
    alone, both, default = counts
    assert alone.readings_uncalibrated == default.readings_uncalibrated == 0
    assert both.readings == default.readings
    assert both.readings_uncalibrated == both.readings - alone.readings > 0
    assert both.frames == 4
    # The calibrated part claims what the calibration says, the rest what the default says.
    assert maps[1].variance_m2[maps[1].state > 1].min() < 0.1 * np.nanmin(maps[2].variance_m2)
    beyond = np.isfinite(maps[1].elevation_m) & (maps[1].x_m > 1.5)
    assert beyond.sum() > 20
    assert maps[1].elevation_m.shape == maps[2].elevation_m.shape
    np.testing.assert_allclose(maps[1].variance_m2[beyond], maps[2].variance_m2[beyond], rtol=0.05)
