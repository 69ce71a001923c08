"""The depth noise file: what comes back, and what is refused in one line."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapping.calibration_file import DeviceIdentity, noise_from_name, noise_to_json, parse_noise
from mapping.errors import MappingError
from mapping.noise import KINECT_V1, NGUYEN_2012, PRESETS, DepthNoiseModel, constant_noise
from simulation.devices.ideal_camera import IDEAL_CAMERA_NOISE

not_negative = st.floats(0.0, 1.0)


def _file(**changes: Any) -> dict[str, Any]:
    return {
        "schema": "terravibe/depth-noise",
        "version": 1,
        "device": {"model": "Kinect V1", "serial": "A0"},
        "model": {"name": "a", "axial_offset_m": 0.001},
    } | changes


def _model(**changes: Any) -> dict[str, Any]:
    return _file(model={"name": "a", "axial_offset_m": 0.001} | changes)


@given(
    st.builds(
        DepthNoiseModel,
        name=st.text(max_size=8),
        axial_offset_m=st.floats(1e-6, 1.0),
        axial_quadratic_per_m=not_negative,
        axial_reference_m=st.floats(-2.0, 2.0),
        axial_angle_m_sqrt_m=not_negative,
        lateral_offset_px=not_negative,
        lateral_angle_px=not_negative,
        quantum_per_m=not_negative,
        bias_m=st.floats(-0.1, 0.1),
        bias_slope=st.floats(-0.1, 0.1),
        bias_quadratic_per_m=st.floats(-0.1, 0.1),
        bias_sigma_m=not_negative,
        bias_sigma_quadratic_per_m=not_negative,
        correlation_area_px=st.floats(1.0, 100.0),
        fixed_share=st.floats(0.0, 1.0),
        range_min_m=st.floats(0.01, 1.0),
        range_max_m=st.floats(1.01, 10.0),
    )
)
def test_a_model_comes_back_bit_for_bit(model: DepthNoiseModel) -> None:
    assert parse_noise(noise_to_json(model), "file") == model


def test_the_file_says_what_it_is_and_of_which_device() -> None:
    content = json.loads(noise_to_json(KINECT_V1, DeviceIdentity(model="Kinect V1", serial="7")))
    assert content["schema"] == "terravibe/depth-noise"
    assert content["version"] == 1
    assert content["device"] == {"model": "Kinect V1", "serial": "7"}
    assert content["model"] == asdict(KINECT_V1)


def test_absent_keys_keep_their_defaults() -> None:
    found = parse_noise(json.dumps(_file()), "file")
    assert found == DepthNoiseModel("a", axial_offset_m=0.001)
    without_device = {key: value for key, value in _file().items() if key != "device"}
    assert parse_noise(json.dumps(without_device), "file") == found


def test_the_simulated_camera_has_a_file_of_this_kind() -> None:
    found = parse_noise(json.dumps(IDEAL_CAMERA_NOISE), "file")
    white = replace(NGUYEN_2012, lateral_offset_px=0, lateral_angle_px=0, fixed_share=0)
    expected = replace(white, name="ideal-camera")
    assert found == expected


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (_model(axial_offset=0.1), r"model\.axial_offset: Extra inputs"),
        (_file(date="2026"), "date: Extra inputs"),
        (_file(device={"colour": "red"}), r"device\.colour: Extra inputs"),
        (_file(version=3), "version: Input should be 1 or 2"),
        (_file(version=2), 'version 2 has "measured", version 1 has not'),
        (_file(version="1"), "version: Input should be 1"),
        (_file(schema="terravibe/mount"), "schema: Input should be 'terravibe/depth-noise'"),
        (_model(axial_offset_m=float("nan")), r"model\.axial_offset_m: Input should be a finite"),
        (_model(bias_m=float("inf")), r"model\.bias_m: Input should be"),
        (_model(axial_offset_m=-0.001), r"model\.axial_offset_m: Input should be greater"),
        (_model(quantum_per_m=-1e-9), r"model\.quantum_per_m: Input should be greater"),
        (_model(bias_sigma_m=-0.1), r"model\.bias_sigma_m: Input should be greater"),
        (_model(bias_slope=1e300), r"model\.bias_slope: Input should be less"),
        (_model(axial_offset_m="0.001"), r"model\.axial_offset_m: Input should be a valid number"),
        (_model(axial_offset_m=True), r"model\.axial_offset_m: Input should be a valid number"),
        (_model(fixed_share=1.5), r"model\.fixed_share: Input should be less"),
        (_model(correlation_area_px=0.5), r"model\.correlation_area_px: Input should be greater"),
        (_model(range_min_m=0.0), r"model\.range_min_m: Input should be greater"),
        (_model(range_min_m=2.0, range_max_m=2.0), "expected the first below the second"),
        (_model(axial_offset_m=0.0), "calls readings at 0.4 m perfect"),
        (
            _model(axial_offset_m=0.0, axial_quadratic_per_m=0.1, axial_reference_m=1.5),
            "calls readings at 1.5 m perfect",
        ),
        ({"schema": "terravibe/depth-noise", "version": 1}, "model: Field required"),
        ([1, 2], "the file: Input should be an object"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(content: object, reason: str) -> None:
    with pytest.raises(MappingError, match=f"^file: .*{reason}") as caught:
        parse_noise(json.dumps(content), "file")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("key", ["schema", "version"])
def test_a_file_that_does_not_say_what_it_is_is_refused(key: str) -> None:
    content = {name: value for name, value in _file().items() if name != key}
    with pytest.raises(MappingError, match=f"file: {key}: Field required"):
        parse_noise(json.dumps(content), "file")


@pytest.mark.parametrize("text", ["", "{", "not json", "\ufeff{}"])
def test_what_is_not_json_is_refused(text: str) -> None:
    with pytest.raises(MappingError, match="file: the file: Invalid JSON") as caught:
        parse_noise(text, "file")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "model",
    [
        DepthNoiseModel("a", axial_offset_m=-1.0),
        DepthNoiseModel("a", axial_offset_m=float("nan")),
        DepthNoiseModel("a", axial_offset_m=0.0),
        DepthNoiseModel("a", axial_offset_m=0.1, range_min_m=5.0),
    ],
)
def test_no_file_is_written_that_could_not_be_read(model: DepthNoiseModel) -> None:
    with pytest.raises(MappingError, match="noise model 'a': "):
        noise_to_json(model)


def test_a_model_is_named_by_preset_constant_or_file(tmp_path: Path) -> None:
    path = tmp_path / "noise.json"
    path.write_text(noise_to_json(KINECT_V1), encoding="utf-8")
    assert noise_from_name(str(path)) == KINECT_V1
    assert noise_from_name("nguyen2012") is PRESETS["nguyen2012"]
    assert noise_from_name("constant:0.01") == constant_noise(0.01)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("constant:much", "expected constant:SIGMA in metres"),
        ("constant:-1", "expected a number above 0"),
        ("kinect", "is none of kinect-v1, nguyen2012, kinect-quantisation"),
        ("", "cannot be read as a calibration file"),
        ("a\0b", "cannot be read as a calibration file"),
    ],
)
def test_an_unknown_name_is_refused(name: str, reason: str) -> None:
    with pytest.raises(MappingError, match=reason):
        noise_from_name(name)


def test_a_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "noise.json"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(MappingError, match="cannot be read as a calibration file"):
        noise_from_name(str(path))
