"""From recording to map: whose settings count, and how the map says it was made."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from acquisition.stream.reader import StreamMessage
from acquisition.stream.writer import StreamWriter
from drivers.samples import DepthFrame, PoseSample, Sample
from drivers.source import SourceInfo
from mapping.alignment.settings import AlignmentSettings
from mapping.calibration_file import DeviceIdentity, noise_to_json, parse_calibration
from mapping.ego_motion.settings import EgoMotionSettings
from mapping.errors import MappingError
from mapping.mapper import Mapper
from mapping.noise import KINECT_V1, NGUYEN_2012, constant_noise
from mapping.output.map_summary import summarise_run
from mapping.recorded import recorded_settings
from mapping.session import MapOptions, MapResult, map_stream
from mapping.settings import MapSettings
from tests.fakes.recordings import reader_of
from tests.mapping.scenes import floor_frame, mount, pose_sample

SOURCE = SourceInfo("fake", "floor", "", (PoseSample, DepthFrame), "recorded")
START_NS = 1_700_000_000_000_000_000


def _samples(frames: int = 3) -> list[Sample]:
    stamps = [START_NS + n * 100_000_000 for n in range(frames)]
    return [sample for t_ns in stamps for sample in (pose_sample(t_ns), floor_frame(t_ns))]


def _recording(settings: Mapping[str, object], frames: int = 3, mounted: bool = True) -> bytes:
    stream = io.BytesIO()
    transforms = mount().transforms if mounted else ()
    with StreamWriter(
        stream, sources=[SOURCE], static_transforms=transforms, settings=settings
    ) as writer:
        for sample in _samples(frames):
            writer.write(sample)
    return stream.getvalue()


def _map(
    recorded: Mapping[str, object], options: MapOptions | None = None, **kwargs: Any
) -> MapResult:
    options = options or MapOptions(MapSettings())
    return map_stream(reader_of(_recording(recorded)), options, **kwargs)


def test_a_recording_gives_the_map_of_its_samples() -> None:
    result = _map({})
    mapper = Mapper(MapSettings(), KINECT_V1)
    for sample in (mount(), *_samples()):
        mapper.add(sample)
    assert result.map.sha256() == mapper.elevation_map().sha256()
    assert result.counts == mapper.counts
    assert result.report.complete
    assert (result.settings, result.noise) == (MapSettings(), KINECT_V1)


def test_progress_sees_every_message() -> None:
    seen: list[StreamMessage] = []
    _map({}, progress=seen.append)
    assert [message.topic for message in seen].count("/depth/image") == 3
    assert [message.topic for message in seen].count("/mocap/pose") == 3


def test_the_recordings_own_calibration_counts_before_the_defaults() -> None:
    recorded = {
        "depth_noise": json.loads(noise_to_json(NGUYEN_2012)),
        "mount_sigma_m": 0.004,
        "mount_sigma_rad": 0.002,
    }
    result = _map(recorded, MapOptions(MapSettings(mount_sigma_m=0.1, mount_sigma_rad=0.1)))
    assert result.noise == NGUYEN_2012
    assert (result.settings.mount_sigma_m, result.settings.mount_sigma_rad) == (0.004, 0.002)


def test_the_users_wish_counts_before_the_recordings_calibration() -> None:
    recorded = {
        "depth_noise": json.loads(noise_to_json(NGUYEN_2012)),
        "mount_sigma_m": 0.004,
        "mount_sigma_rad": 0.002,
    }
    noise = constant_noise(0.01)
    options = MapOptions(MapSettings(), noise=noise, mount_sigma_m=0.0, mount_sigma_rad=0.001)
    result = _map(recorded, options)
    assert result.noise == noise
    assert (result.settings.mount_sigma_m, result.settings.mount_sigma_rad) == (0.0, 0.001)


def test_settings_count_where_the_recording_says_nothing() -> None:
    result = _map({}, MapOptions(MapSettings(mount_sigma_m=0.003)))
    assert result.settings.mount_sigma_m == 0.003
    known = result.map.systematic_m2[result.map.known]
    assert known.min() == pytest.approx(0.003**2, rel=0.5)


@pytest.mark.parametrize(
    ("recorded", "reason"),
    [
        ({"mount_sigma_m": "wide"}, "the recording's mount sigma is 'wide'; expected a number"),
        ({"mount_sigma_rad": True}, "the recording's mount sigma is True; expected a number"),
        ({"mount_sigma_m": -1.0}, "mount_sigma_m is -1.0; expected 0 or more"),
        ({"depth_noise": {"version": 1}}, "the recording's depth_noise: "),
        ({"depth_noise": "kinect-v1"}, "the recording's depth_noise: the file: Input should be"),
    ],
)
def test_a_recording_with_an_unusable_calibration_is_refused(
    recorded: dict[str, object], reason: str
) -> None:
    with pytest.raises(MappingError, match=reason) as caught:
        _map(recorded)
    assert "\n" not in str(caught.value)


def test_settings_that_are_no_json_object_are_refused() -> None:
    with pytest.raises(MappingError, match="the recording's settings are not JSON"):
        recorded_settings({"terravibe": {"settings": "{"}})
    with pytest.raises(MappingError, match="the recording's settings are not a JSON object"):
        recorded_settings({"terravibe": {"settings": "[1]"}})
    assert recorded_settings({}) == recorded_settings({"terravibe": {}}) == {}


def test_a_world_wants_a_scrolling_window(tmp_path: Path) -> None:
    options = MapOptions(MapSettings(), world=tmp_path / "w")
    with pytest.raises(MappingError, match="a world is mapped through a scrolling window"):
        _map({}, options)
    assert not (tmp_path / "w").exists()


def test_boxes_of_the_recording_count_unless_they_are_none() -> None:
    box = [5.0, 5.0, 5.0, 6.0, 6.0, 6.0]
    with pytest.raises(MappingError, match="does not connect base_link with"):
        _map({"map": {"body_boxes_m": [box]}})
    with pytest.raises(MappingError, match="body_boxes_m has"):
        _map({"map": {"body_boxes_m": [box[:5]]}})
    with pytest.raises(MappingError, match="map section has body_boxes_m = 'none'"):
        _map({"map": {"body_boxes_m": "none"}})


def test_the_paper_mode_is_a_method_and_says_so() -> None:
    result = _map({}, MapOptions(MapSettings(), method="paper2019"))
    assert result.map.attributes["method"] == "paper2019"
    assert result.counts.frames == 3
    assert "method" not in _map({}).map.attributes


def test_the_map_says_how_it_was_made() -> None:
    result = _map({"mount_sigma_m": 0.004})
    attributes = result.map.attributes
    settings = asdict(result.settings) | {"body_boxes_m": "[]"}
    for section in ("alignment", "gravity", "aligned_errors", "ego_motion"):
        settings |= {f"{section}_{name}": value for name, value in settings.pop(section).items()}
    for name, value in settings.items():
        assert attributes[f"setting_{name}"] == value
    for name, value in asdict(KINECT_V1).items():
        assert attributes[f"noise_{name}"] == value
    for name, value in asdict(result.counts).items():
        assert attributes[f"input_{name}"] == value
    assert (attributes["input_complete"], attributes["input_damaged_parts"]) == (1, 0)
    assert (attributes["input_truncated_bytes"], attributes["input_late_messages"]) == (0, 0)
    assert all(isinstance(value, str | int | float) for value in attributes.values())


def test_a_truncated_recording_is_mapped_as_far_as_it_goes() -> None:
    whole = _recording({}, frames=12)
    result = map_stream(reader_of(whole[: len(whole) // 2]), MapOptions(MapSettings()))
    assert 0 < result.counts.frames < 12
    assert result.map.attributes["input_complete"] == 0


def test_a_recording_without_frames_or_mount_says_so() -> None:
    with pytest.raises(MappingError, match="the stream holds no depth frame"):
        map_stream(reader_of(_recording({}, frames=0)), MapOptions(MapSettings()))
    unmounted = reader_of(_recording({}, mounted=False))
    with pytest.raises(MappingError, match="record the mount of the depth sensor"):
        map_stream(unmounted, MapOptions(MapSettings()))


def test_map_settings_reach_the_grid() -> None:
    result = _map({}, MapOptions(MapSettings(resolution_m=0.1, grid="scrolling", window_m=2.0)))
    assert result.map.resolution_m == 0.1
    assert result.map.x_m.max() < 1.0
    assert result.counts.readings_outside > 0
    assert math.isclose(result.map.x_m[1] - result.map.x_m[0], 0.1)


def test_a_window_that_the_rover_looks_over_is_told_as_one() -> None:
    options = MapOptions(MapSettings(grid="scrolling", window_m=0.05))
    with pytest.raises(MappingError, match=r"depth readings fell outside the window of 0\.05 m"):
        _map({}, options)


def test_the_recordings_map_section_counts_where_the_user_says_nothing() -> None:
    recorded = {"map": {"resolution_m": 0.1, "gate_sigma": 2.5, "grid": "scrolling"}}
    options = MapOptions(MapSettings(resolution_m=0.05), given=frozenset({"resolution_m"}))
    result = _map(recorded, options)
    assert (result.settings.resolution_m, result.settings.gate_sigma) == (0.05, 2.5)
    assert result.settings.grid == "scrolling"


@pytest.mark.parametrize(
    "section", [3, {"colour": 1}, {"gate_sigma": "wide"}, {"grid": 2}, {"gate_sigma": -1.0}]
)
def test_a_map_section_that_is_none_is_refused(section: object) -> None:
    with pytest.raises(MappingError, match=r"map section|gate_sigma"):
        _map({"map": section}, MapOptions(MapSettings()))


def test_sections_of_the_recorded_map_count_value_by_value() -> None:
    section = {"alignment": {"form": "z-roll-pitch"}, "ego_motion": {"tick_s": 0.05}}
    result = _map({"map": section})
    assert result.settings.alignment == AlignmentSettings(form="z-roll-pitch")
    assert result.settings.ego_motion == EgoMotionSettings(tick_s=0.05)


@pytest.mark.parametrize(
    "section",
    [
        {"alignment": {"forms": "6-dof"}},
        {"alignment": {"form": 6}},
        {"alignment": 3},
        {"ego_motion": {"use_external_poses": 1.0}},
        {"pose_source": "stars"},
    ],
)
def test_unknown_or_wrong_values_of_sections_are_refused(section: dict[str, object]) -> None:
    with pytest.raises(MappingError):
        _map({"map": section})


def _file_of(serial: str) -> str:
    return noise_to_json(constant_noise(0.01), DeviceIdentity(model="K", serial=serial))


def _from_device(serial: str, options: MapOptions, recorded: Mapping[str, object]) -> MapResult:
    stream = io.BytesIO()
    source = replace(SOURCE, serial=serial)
    with StreamWriter(
        stream, sources=[source], static_transforms=mount().transforms, settings=recorded
    ) as writer:
        for sample in _samples():
            writer.write(sample)
    return map_stream(reader_of(stream.getvalue()), options)


def test_the_calibration_of_the_recording_s_device_is_found(tmp_path: Path) -> None:
    for serial in ("A1", "B2"):
        (tmp_path / f"{serial}.json").write_text(_file_of(serial))
    options = MapOptions(MapSettings(), calibrations=tmp_path)
    assert _from_device("A1", options, {}).noise.axial_offset_m == 0.01
    found = _from_device("A1", options, {})
    assert (found.noise_warning, "noise_warning" in found.map.attributes) == ("", False)
    assert found.map.attributes["noise_source"] == str(tmp_path / "A1.json")
    assert _from_device("C3", options, {}).noise.name == KINECT_V1.name


@pytest.mark.parametrize(
    ("serial", "wanted"),
    [("C3", "of floor C3, in"), ("", "of floor, which has no serial number, in")],
)
def test_a_calibration_that_is_not_there_is_missed_aloud(
    tmp_path: Path, serial: str, wanted: str
) -> None:
    """Which device, what is there instead, and which model is used."""
    (tmp_path / "A1.json").write_text(_file_of("A1"))
    options = MapOptions(MapSettings(), calibrations=tmp_path)
    result = _from_device(serial, options, {})
    said = (
        f"no depth calibration {wanted} {tmp_path}: A1.json of K A1; "
        f"noise model {KINECT_V1.name} (default) is used"
    )
    assert result.noise_warning == said
    assert result.map.attributes["noise_warning"] == said
    summary = summarise_run(result, "x.nc")
    assert said in summary.warnings
    # The recording's own model stands in, if there is one; what the user names is not doubted.
    own = {"depth_noise": json.loads(noise_to_json(NGUYEN_2012))}
    assert "(the recording's depth_noise) is used" in _from_device("C3", options, own).noise_warning
    named = replace(options, noise=NGUYEN_2012, calibrations=None)
    assert _from_device("C3", named, {}).noise_warning == ""
    (tmp_path / "A1.json").unlink()
    assert "none of any device; " in _from_device("C3", options, {}).noise_warning


def test_a_depth_calibration_among_the_others_of_rover_toml_is_told() -> None:
    recorded = {"calibration_files": {"k.json": json.loads(_file_of("C3")), "gyro.json": {}}}
    result = _from_device("C3", MapOptions(MapSettings()), recorded)
    assert "no depth_noise for floor C3; it has k.json among others" in result.noise_warning
    assert result.noise == KINECT_V1


def test_another_device_s_calibration_is_refused(tmp_path: Path) -> None:
    calibration = parse_calibration(_file_of("A1"), "a.json")
    options = MapOptions(MapSettings(), noise=calibration)
    assert _from_device("A1", options, {}).noise.name == "constant"
    assert _from_device("", options, {}).noise.name == "constant"  # nobody can tell
    with pytest.raises(MappingError, match=r"a\.json was measured on K A1, the recording is of"):
        _from_device("B2", options, {})
    recorded = {"depth_noise": json.loads(_file_of("A1"))}
    with pytest.raises(MappingError, match="the recording's depth_noise was measured on K A1"):
        _from_device("B2", MapOptions(MapSettings()), recorded)
