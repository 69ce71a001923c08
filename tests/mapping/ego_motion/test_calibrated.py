"""What a static rig measured becomes settings of ego-motion."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from calibration_rigs.static_rig.accelerometer import AccelerometerCalibration as RigCalibration
from drivers.samples import AccelerationSample, YawRateSample
from mapping.calibration_file import DeviceIdentity
from mapping.ego_motion.calibrated import calibrated
from mapping.ego_motion.front_end import FrontEnd
from mapping.ego_motion.intake import Intake
from mapping.ego_motion.settings import EgoMotionSettings
from mapping.errors import MappingError
from mapping.mounts import MountTree

DEFAULT = EgoMotionSettings(gyro_delay_s=0.0, acceleration_delay_s=0.0)
GYRO = DeviceIdentity(model="XV7001BB", serial="G1")
FORCE = DeviceIdentity(model="AFT601D", serial="A1")
DEVICES = {"gyro": GYRO, "accelerometer": FORCE}


def number(value: float, sigma: float | None = None) -> dict[str, float]:
    return {"value": value} if sigma is None else {"value": value, "sigma": sigma}


def gyro_file(serial: str = "G1") -> dict[str, object]:
    noise = {
        "white_per_sqrt_hz": number(1e-4),
        "bias_instability": number(3e-4),
        "random_walk_sqrt_hz": number(2e-5),
        "duration_s": 600.0,
    }
    gyro = {"bias_rad_s": number(0.01, 1e-5), "noise": noise, "scale": number(1.02, 0.004)}
    device = {"model": "XV7001BB", "serial": serial}
    return {"schema": "terravibe/inertial", "version": 1, "device": device, "gyro": gyro}


def force_file() -> dict[str, object]:
    part = {
        "scale": [number(1.0), number(1.1), number(0.9)],
        "bias_m_s2": [number(0.1, 0.01), number(-0.2, 0.02), number(0.3, 0.01)],
        "crooked_rad": [0.001, -0.002, 0.003],
    }
    device = {"model": "AFT601D", "serial": "A1"}
    return {"schema": "terravibe/inertial", "version": 1, "device": device, "accelerometer": part}


def test_without_a_file_nothing_changes_and_it_is_said() -> None:
    found = calibrated(DEFAULT, DEVICES, {}, None)
    assert found.settings == DEFAULT
    assert [note.split(":")[0] for note in found.notes] == ["gyro", "accelerometer"]
    assert all("no calibration" in note for note in found.notes)


def test_the_recorded_file_tells_noise_bias_and_scale_of_the_gyro() -> None:
    found = calibrated(DEFAULT, DEVICES, {"gyro.json": gyro_file()}, None)
    s = found.settings
    # IEEE Std 952: N^2 / tau is the variance of a mean; the filter's density is one-sided.
    assert s.gyro_noise_rad_s_per_sqrt_hz == pytest.approx(math.sqrt(2.0) * 1e-4)
    assert (s.gyro_zero_rad_s, s.gyro_scale, s.gyro_scale_sigma) == (0.01, 1.02, 0.004)
    assert s.gyro_bias_walk_rad_s_per_sqrt_s == 2e-5
    assert 0.002 < s.gyro_bias_rad_s < 0.0022
    assert "the recording, measured on XV7001BB G1" in found.notes[0]
    assert "2 h" in found.warnings[0]


def test_the_folder_goes_before_the_recording_by_serial_number(tmp_path: Path) -> None:
    (tmp_path / "other.json").write_text(json.dumps(gyro_file("G2")), encoding="utf-8")
    (tmp_path / "force.json").write_text(json.dumps(force_file()), encoding="utf-8")
    found = calibrated(DEFAULT, DEVICES, {}, tmp_path)
    assert found.settings.gyro_zero_rad_s == 0.0
    assert "force.json" in found.notes[1]
    assert found.settings.levelling_bias_rad == pytest.approx(math.hypot(0.02 / 9.80665, 0.001))
    (tmp_path / "again.json").write_text(json.dumps(force_file()), encoding="utf-8")
    with pytest.raises(MappingError, match="keep one"):
        calibrated(DEFAULT, DEVICES, {}, tmp_path)
    with pytest.raises(MappingError, match="no folder"):
        calibrated(DEFAULT, DEVICES, {}, tmp_path / "none")


def test_the_file_of_another_device_is_refused() -> None:
    with pytest.raises(MappingError, match="measured on XV7001BB G2"):
        calibrated(DEFAULT, DEVICES, {"gyro.json": gyro_file("G2")}, None)


def test_of_recorded_files_the_device_s_own_is_taken() -> None:
    """A gyro that has accelerations too, beside the accelerometer."""
    both = gyro_file() | {"accelerometer": {"bias_m_s2": [number(9.0)] * 3}}
    files = {"both.json": both, "force.json": force_file()}
    found = calibrated(DEFAULT, DEVICES, files, None)
    assert found.settings.force_zero_x_m_s2 == 0.1
    assert [note.rsplit(" ", 1)[1] for note in found.notes] == ["G1", "A1"]
    with pytest.raises(MappingError, match="has 2 calibrations of accelerometer A1; give --cal"):
        calibrated(DEFAULT, DEVICES, files | {"again.json": force_file()}, None)


def test_readings_are_corrected_as_the_rig_defines_it() -> None:
    recorded = {"gyro.json": gyro_file(), "force.json": force_file()}
    settings = calibrated(DEFAULT, DEVICES, recorded, None).settings
    intake = Intake(settings, MountTree(), FrontEnd(settings))
    rate = intake.reading(YawRateSample(0, 0.51, None, None, 0))
    assert rate is not None
    assert rate.values[0] == pytest.approx(1.02 * 0.5)
    bias, angles, none = np.array([0.1, -0.2, 0.3]), np.array([0.001, -0.002, 0.003]), np.zeros(3)
    rig = RigCalibration(np.array([1.0, 1.1, 0.9]), none, bias, none, angles, 0.0, 9)
    reading = np.array([1.0, 2.0, 9.0])
    force = intake.reading(AccelerationSample(0, reading, 0))
    assert force is not None
    np.testing.assert_allclose(force.values, rig.force_m_s2(reading[np.newaxis])[0], rtol=1e-12)
