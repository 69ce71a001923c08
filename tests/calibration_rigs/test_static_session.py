"""Recordings of a rig that is made of numbers, through the stream, to a calibration file."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import cli
from acquisition.importing import record_all
from calibration_rigs.errors import RigError
from calibration_rigs.static_rig import session
from calibration_rigs.static_rig.signals import read_signals
from drivers.samples import AccelerationSample, PoseSample, Sample, YawRateSample, frozen_array
from drivers.source import SourceInfo
from mapping.errors import MappingError
from mapping.inertial_calibration import read_inertial
from tests.fakes.finite_source import FiniteSource
from tests.fakes.recordings import START_NS, pose

STEP_NS = 10_000_000  # 100 Hz
G_M_S2 = 9.80665


class _Rig(FiniteSource):
    """A source that names the sensors of the rig."""

    def open(self) -> SourceInfo:
        kinds = (YawRateSample, AccelerationSample, PoseSample)
        return replace(super().open(), produces=kinds)


def _record(path: Path, samples: list[Sample]) -> Path:
    record_all(
        _Rig(sorted(samples, key=lambda sample: sample.t_ns)),
        path,
        static_transforms=[],
        settings={},
    )
    return path


def _rates(rates: np.ndarray, temperature_c: np.ndarray | None = None) -> list[Sample]:
    return [
        YawRateSample(
            START_NS + i * STEP_NS,
            float(rate),
            None if temperature_c is None else float(temperature_c[i]),
            None,
            i,
        )
        for i, rate in enumerate(rates)
    ]


def _forces(forces: np.ndarray) -> list[Sample]:
    return [
        AccelerationSample(START_NS + i * STEP_NS, frozen_array(force, (3,)), i)
        for i, force in enumerate(forces)
    ]


@pytest.fixture(scope="module")
def at_rest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a minute of a gyro (white 1e-3 rad/s/sqrt(Hz), bias 0.01) and an accelerometer."""
    rng = np.random.default_rng(1)
    rates = 0.01 + rng.normal(0.0, 1e-3 * math.sqrt(100.0), 6000)
    forces = rng.normal([0.0, 0.0, G_M_S2], 0.02, (6000, 3))
    warm = np.linspace(20.0, 30.0, 6000)
    path = tmp_path_factory.mktemp("rig") / "rest.mcap"
    return _record(path, [*_rates(rates, warm), *_forces(forces)])


def test_rest_gives_noise_and_bias_with_a_warning_that_it_was_short(at_rest: Path) -> None:
    found = session.calibrate_rest(read_signals(at_rest))
    gyro, accelerometer = found.file.gyro, found.file.accelerometer
    assert gyro is not None
    assert gyro.noise is not None
    assert accelerometer is not None
    assert accelerometer.noise is not None
    assert gyro.noise.white_per_sqrt_hz.value == pytest.approx(1e-3, rel=0.05)
    assert gyro.bias_rad_s is not None
    assert gyro.bias_rad_s.sigma is not None
    assert abs(gyro.bias_rad_s.value - 0.01) < 3.0 * gyro.bias_rad_s.sigma
    assert gyro.bias_per_c is not None
    assert accelerometer.noise[1].white_per_sqrt_hz.value == pytest.approx(0.002, rel=0.05)
    assert sorted(found.curves) == ["accelerometer x", "accelerometer y", "accelerometer z", "gyro"]
    assert any("two to three hours" in text for text in found.warnings)


def test_a_recording_in_which_something_moves_is_no_rest(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    rates = rng.normal(0.0, 0.01, 3000)
    rates[1000:1500] += 0.5 * np.sin(np.arange(500) / 10.0)
    signals = read_signals(_record(tmp_path / "moved.mcap", _rates(rates)))
    with pytest.raises(RigError, match=r"not at rest for 2\d % of the recording"):
        session.calibrate_rest(signals)


def test_a_gap_is_named_and_the_longer_part_used(tmp_path: Path) -> None:
    samples = _rates(np.random.default_rng(3).normal(0.0, 0.01, 5000))
    signals = read_signals(_record(tmp_path / "gap.mcap", samples[:1500] + samples[1600:]))
    found = session.calibrate_rest(signals)
    assert any("gaps; the longest stretch without, 34 s, was used" in t for t in found.warnings)


def test_too_short_a_rest_is_refused(tmp_path: Path) -> None:
    signals = read_signals(_record(tmp_path / "short.mcap", _rates(np.arange(500) % 7 * 1e-3)))
    with pytest.raises(RigError, match="500 samples without a gap; expected 1000 or more"):
        session.calibrate_rest(signals)


def _attitudes() -> np.ndarray:
    """Return 10 rests of 6 s in several attitudes with turns of 2 s between; scale and bias."""
    rng = np.random.default_rng(4)
    rests = Rotation.random(10, random_state=1)
    parts = []
    for i, attitude in enumerate(rests):
        force = np.tile(attitude.apply([0.0, 0.0, G_M_S2]), (600, 1))
        shaken = force[:200] + 3.0 * np.sin(np.arange(200) / 5.0 + i)[:, None]
        parts += [force, shaken]
    clean = np.vstack(parts)
    return [1.02, 0.98, 1.01] * clean + [0.1, -0.2, 0.05] + rng.normal(0.0, 0.01, clean.shape)


def test_all_parts_join_in_one_file(tmp_path: Path, at_rest: Path) -> None:
    attitudes = _record(tmp_path / "attitudes.mcap", _forces(_attitudes()))
    rng = np.random.default_rng(5)
    turning = np.concatenate([np.zeros(600), np.full(200, math.pi / 4.0 / 1.05), np.zeros(600)])
    turns = _record(tmp_path / "turns.mcap", _rates(turning + rng.normal(0.01, 0.001, 1400)))
    shaker = tmp_path / "shaker.csv"
    shaker.write_text("frequency_hz,reference_m_s2,sensor_m_s2\n80,10,9\n80,10,9.2\n")
    output = tmp_path / "static.json"
    found = session.join(
        [
            session.calibrate_rest(read_signals(at_rest)),
            session.calibrate_attitudes(read_signals(attitudes), G_M_S2),
            session.calibrate_turns(read_signals(turns), [math.pi / 2.0]),
            session.calibrate_shaker(shaker),
        ]
    )
    output.write_text(found.file.to_json())
    file = read_inertial(output)
    assert file == found.file
    assert [item.name for item in file.recordings] == ["rest.mcap", "attitudes.mcap", "turns.mcap"]
    assert file.accelerometer is not None
    assert file.accelerometer.scale is not None
    assert file.accelerometer.noise is not None
    assert [s.value for s in file.accelerometer.scale] == pytest.approx(
        [1.02, 0.98, 1.01], rel=1e-3
    )
    assert file.gyro is not None
    assert file.gyro.noise is not None
    assert file.gyro.scale is not None
    assert file.gyro.scale.value == pytest.approx(1.05, rel=2e-3)
    assert file.vibration[0].ratio == pytest.approx(0.91)
    text = "\n".join(found.describe())
    assert "gyro scale: 1.0" in text
    assert "vibration at 80 Hz: 0.9100 of the reference" in text
    json.dumps(found.as_json(), allow_nan=False)


@pytest.mark.parametrize("text", ["", "{}", '{"schema": "terravibe/inertial", "version": 2}'])
def test_what_is_no_inertial_calibration_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "static.json"
    path.write_text(text)
    with pytest.raises(MappingError, match="expected an inertial calibration, version 1"):
        read_inertial(path)


def test_a_recording_without_inertial_sensors_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RigError, match="holds neither /gyro nor /acceleration"):
        read_signals(_record(tmp_path / "poses.mcap", [pose(0)]))


def test_the_command_writes_the_file_and_the_figure(
    tmp_path: Path, at_rest: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output, figure = tmp_path / "static.json", tmp_path / "allan.png"
    words = ["calibrate", "static", "--rest", str(at_rest), "-o", str(output)]
    table = tmp_path / "deviations.csv"
    more = ["--figure", str(figure), "--serial", "A1", "--deviations", str(table)]
    assert cli.main([*words, *more]) == 0
    assert "gyro noise: N 0.00" in capsys.readouterr().out
    assert read_inertial(output).device.serial == "A1"
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert "gyro,tdev,0.01," in table.read_text()


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["--turns", "x.mcap"],
        ["--rest", "/nonexistent.mcap"],
        ["--shaker", "/none.csv"],
        ["--shaker", "/none.csv", "--deviations", "/none.csv"],
        ["--shaker", "/none.csv", "--deviations", "d.csv"],
        ["--rest", "/nonexistent.mcap", "--deviations", "/none/d.csv"],
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    output = tmp_path / "static.json"
    assert cli.main(["calibrate", "static", "-o", str(output), *words]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert not output.exists()


@pytest.mark.parametrize(
    "words",
    [
        ["delay", "R", "-o", "R"],
        ["mount", "R", "-o", "R"],
        ["static", "--rest", "R", "-o", "R"],
        ["static", "--rest", "R", "-o", "a.json", "--deviations", "R"],
        ["static", "--rest", "R", "-o", "a.json", "--figure", "R"],
    ],
)
def test_no_calibration_takes_the_place_of_its_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    recording = tmp_path / "rest.mcap"
    recording.write_bytes(b"hours of work")
    given = [str(recording) if word == "R" else word for word in words]
    with pytest.raises(SystemExit, match="2"):
        cli.main(["calibrate", *given])
    assert "expected a name ending in" in capsys.readouterr().err
    assert recording.read_bytes() == b"hours of work"
