"""Delays between yaw sensors: known ones, through the estimator and through a recording."""

from __future__ import annotations

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import cli
from acquisition.importing import record_all
from calibration_rigs.errors import RigError
from calibration_rigs.static_rig.delay import YawRate, relative_delay
from calibration_rigs.static_rig.delay_session import DelayCalibration
from calibration_rigs.static_rig.gaps import Gap
from drivers.samples import PoseSample, Sample, WheelTwistSample, YawRateSample, frozen_array
from drivers.source import SourceInfo
from mapping.ego_motion.settings import EgoMotionSettings
from tests.fakes.finite_source import FiniteSource
from tests.fakes.recordings import START_NS

Float64Array = NDArray[np.float64]
_HERTZ = np.array([0.31, 0.47, 0.83, 1.07, 1.61])


class _Rover(FiniteSource):
    """A source that names the yaw sensors."""

    def open(self) -> SourceInfo:
        kinds = (PoseSample, YawRateSample, WheelTwistSample)
        return replace(super().open(), produces=kinds)


def _rate(t_s: Float64Array, seed: int = 0) -> Float64Array:
    """Return the yaw rate of a rover that is turned by hand, rad/s; some 40 degrees to and fro."""
    phase = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, _HERTZ.size)
    sines = np.sin(2.0 * np.pi * _HERTZ * t_s[:, np.newaxis] + phase)
    return np.asarray(0.4 * sines.sum(axis=1), np.float64)


def _yaw(t_s: Float64Array) -> Float64Array:
    fine = np.arange(t_s[0] - 1.0, t_s[-1] + 1.0, 1e-3)
    return np.interp(t_s, fine + 0.5e-3, np.cumsum(_rate(fine)) * 1e-3)


def _pair(
    delay_s: float, seed: int, noise: float = 0.02, seconds: float = 15.0
) -> tuple[YawRate, YawRate]:
    random = np.random.default_rng(seed)
    a, b = np.arange(0.0, seconds, 0.01), np.arange(0.004, seconds, 1.0 / 189.0)
    b = b + random.uniform(-3e-4, 3e-4, b.size)
    return (
        YawRate(a, _rate(a, seed) + noise * random.standard_normal(a.size)),
        YawRate(b, 0.97 * _rate(b - delay_s, seed) + 0.03 + noise * random.standard_normal(b.size)),
    )


def test_the_delay_is_found_to_a_fraction_of_a_sample_and_its_sigma_is_honest() -> None:
    scores = []
    for seed in range(15):
        delay_s = 0.0137 * seed / 10.0 - 0.007
        found = relative_delay(*_pair(delay_s, seed))
        assert abs(found.delay_s - delay_s) < min(3.5 * found.sigma_s, 1e-3)
        assert found.gain == pytest.approx(0.97, abs=0.01)
        scores.append((found.delay_s - delay_s) / found.sigma_s)
    assert 0.5 < float(np.std(scores)) < 1.4


def test_changing_sides_changes_the_sign() -> None:
    a, b = _pair(0.02, 3)
    there, back = relative_delay(a, b), relative_delay(b, a)
    assert there.delay_s == pytest.approx(-back.delay_s, abs=1e-4)
    assert there.delay_s > 0.019


def test_an_axis_that_points_down_has_a_negative_gain() -> None:
    a, b = _pair(0.02, 3)
    found = relative_delay(a, YawRate(b.t_s, -b.rate_rad_s))
    assert found.gain < -0.9
    assert found.delay_s == pytest.approx(0.02, abs=3e-4)


def test_what_says_nothing_is_refused() -> None:
    a, b = _pair(0.02, 3)
    with pytest.raises(RigError, match="expected at least 11 s of turning"):
        relative_delay(*_pair(0.02, 3, seconds=8.0))
    random = np.random.default_rng(0)
    still = YawRate(b.t_s, 0.01 * random.standard_normal(b.t_s.size))
    with pytest.raises(RigError, match="agree to a correlation of 0"):
        relative_delay(a, still)
    for rate_rad_s in (0.0, 0.1):
        stuck = YawRate(b.t_s, np.full(b.t_s.size, rate_rad_s))
        for pair in ((a, stuck), (stuck, a)):
            with pytest.raises(RigError, match="the same rate all the time"):
                relative_delay(*pair)
    late = YawRate(b.t_s + 100.0, b.rate_rad_s)
    with pytest.raises(RigError, match=r"overlap for 0\.0 s"):
        relative_delay(a, late)


@pytest.mark.parametrize("where", ["reference", "other"])
def test_a_gap_does_not_bias_the_delay(where: str) -> None:
    """Drawn through it, 0.5 s of the 15 shift the delay by up to 9 ms."""
    a, b = _pair(0.02, 5, noise=0.05)
    holed = [
        YawRate(r.t_s[keep], r.rate_rad_s[keep])
        for r in (a, b)
        for keep in [(r.t_s < 7.0) | (r.t_s > 7.5)]
    ]
    found = relative_delay(holed[0], b) if where == "reference" else relative_delay(a, holed[1])
    assert abs(found.delay_s - 0.02) < min(3.5 * found.sigma_s, 1e-3)
    whole = relative_delay(a, b)
    assert 0.5 < whole.duration_s - found.duration_s < 2.0
    assert found.correlation == pytest.approx(whole.correlation, abs=0.01)


def test_what_gaps_leave_must_be_enough() -> None:
    a, b = _pair(0.02, 3)
    keep = (a.t_s < 5.0) | (a.t_s > 9.0)
    with pytest.raises(RigError, match=r"overlap for 15\.0 s, 5\.3 s of it at gaps; expected at"):
        relative_delay(YawRate(a.t_s[keep], a.rate_rad_s[keep]), b)


def _recorded(path: Path, gyro_s: float, wheels_s: float, silent_s: float = 0.0) -> Path:
    """Record poses, a gyro and wheels whose stamps are late by so much.

    Poses and gyro are silent for so long, from 7 and 8 s on.
    """
    t_s = np.arange(0.0, 16.0, 0.01)
    stamp = [START_NS + round(1e9 * t) for t in t_s]
    still = frozen_array(np.zeros((6, 6)), (6, 6))
    samples: list[Sample] = []
    for k, yaw in enumerate(_yaw(t_s)):
        quat = frozen_array([np.cos(yaw / 2.0), 0.0, 0.0, np.sin(yaw / 2.0)], (4,))
        samples.append(PoseSample(stamp[k], frozen_array(np.zeros(3), (3,)), quat, still, k))
    for k, rate in enumerate(_rate(t_s - gyro_s)):
        samples.append(YawRateSample(stamp[k] + 1_000_000, float(rate), None, None, k))
    for k, rate in enumerate(_rate(t_s[::2] - wheels_s)):
        samples.append(
            WheelTwistSample(stamp[2 * k] + 2_000_000, 0.0, float(rate), 0.01, 0.01, None, None, k)
        )
    for kind, from_s in ((PoseSample, 7.0), (YawRateSample, 8.0)):
        first, last = (START_NS + round(1e9 * t) for t in (from_s, from_s + silent_s))
        samples = [s for s in samples if not (isinstance(s, kind) and first < s.t_ns < last)]
    samples.sort(key=lambda sample: sample.t_ns)
    record_all(_Rover(samples), path, static_transforms=[], settings={})
    return path


def test_the_file_is_what_ego_motion_takes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Stamps 1 and 2 ms late on top of delays of 5 and 20 ms."""
    recording = _recorded(tmp_path / "turns.mcap", 0.005, 0.020)
    output = tmp_path / "delay.toml"
    words = ["calibrate", "delay", str(recording), "-o", str(output)]
    assert cli.main(words) == 0
    assert "reference: mocap" in capsys.readouterr().out
    section = tomllib.loads(output.read_text())["map"]["ego_motion"]
    settings = EgoMotionSettings(**section)
    assert settings.gyro_delay_s == pytest.approx(0.006, abs=3e-4)
    assert settings.wheels_delay_s == pytest.approx(0.022, abs=3e-4)

    assert cli.main([*words, "--reference", "gyro", "--reference-delay-ms", "3", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["delays"]["wheels"]["delay_s"] == pytest.approx(0.016, abs=3e-4)
    section = tomllib.loads(output.read_text())["map"]["ego_motion"]
    assert section["gyro_delay_s"] == 0.003
    assert section["wheels_delay_s"] == pytest.approx(0.019, abs=3e-4)


def test_an_early_sensor_and_gaps_get_warnings_and_the_early_one_no_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = _recorded(tmp_path / "turns.mcap", -0.015, 0.020, silent_s=0.4)
    output = tmp_path / "delay.toml"
    assert cli.main(["calibrate", "delay", str(recording), "-o", str(output)]) == 0
    told = capsys.readouterr().out
    assert "warning: gyro is earlier than the reference" in told
    line = r"warning: {} has no samples for 0\.4\d s, {}\.\d\d s after the first; what lies around"
    assert re.search(line.format("mocap", "[67]"), told)
    assert re.search(line.format("gyro", "[78]"), told)
    assert "wheels has" not in told
    assert "# gyro has no samples for 0.4" in output.read_text()
    section = tomllib.loads(output.read_text())["map"]["ego_motion"]
    assert set(section) == {"wheels_delay_s"}
    assert section["wheels_delay_s"] == pytest.approx(0.022, abs=3e-4)


def test_gaps_are_numbers_in_json() -> None:
    found = DelayCalibration("gyro", 0.0, {}, "turns.mcap", {"gyro": (Gap(1.0, 3.0),)})
    assert json.loads(json.dumps(found.as_json()))["gaps"] == {
        "gyro": [{"begin_s": 1.0, "end_s": 3.0}]
    }


@pytest.mark.parametrize("late_ms", ["nan", "1e9", "late"])
def test_a_lag_that_is_none_is_refused(late_ms: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["calibrate", "delay", "a.mcap", "-o", "a.toml", f"--reference-delay-ms={late_ms}"]
    with pytest.raises(SystemExit, match="2"):
        cli.main(words)
    assert "expected milliseconds" in capsys.readouterr().err


def test_a_reference_that_is_early_gets_no_line_that_ego_motion_refuses() -> None:
    found = DelayCalibration("gyro", -0.001, {}, "turns.mcap")
    assert tomllib.loads(found.toml())["map"]["ego_motion"] == {}


def test_one_sensor_is_not_enough(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    samples: list[Sample] = [YawRateSample(START_NS + k, 0.0, None, None, k) for k in range(9)]
    record_all(_Rover(samples), tmp_path / "a.mcap", static_transforms=[], settings={})
    output = tmp_path / "delay.toml"
    assert cli.main(["calibrate", "delay", str(tmp_path / "a.mcap"), "-o", str(output)]) == 2
    assert "holds yaw of gyro; expected at least two of mocap, gyro, wheels" in (
        capsys.readouterr().err
    )
    assert not output.exists()
