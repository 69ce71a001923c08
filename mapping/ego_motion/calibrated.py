"""Settings of ego-motion from what a static rig measured of the recording's own sensors.

The calibration's white noise N is that of IEEE Std 952 (variance of a mean over tau: N^2 / tau),
the filter's density the one-sided one of data sheets: sqrt(2) N. Of the accelerometer's noise the
filter takes nothing: it measures the scatter of the forces while it drives.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mapping.calibration_file import DeviceIdentity
from mapping.ego_motion.settings import EgoMotionSettings
from mapping.errors import MappingError
from mapping.files import read_whole
from mapping.inertial_calibration import (
    AccelerometerCalibration,
    GyroCalibration,
    InertialFile,
    parse_inertial,
)

_SCHEMA = '"terravibe/inertial"'
# What no rest measures: how the bias differs from switch-on to switch-on, temperatures of a day.
_SWITCH_ON_RAD_S = 0.002
_TEMPERATURE_C = 10.0
# How well an accelerometer is mounted to the rover.
_MOUNT_RAD = 0.001
_LONG_ENOUGH_S = 7200.0


@dataclass(frozen=True, slots=True)
class CalibratedSettings:
    """Settings, and a sentence for every source of their sigmas and for every doubt."""

    settings: EgoMotionSettings
    notes: tuple[str, ...]
    warnings: tuple[str, ...]


def calibrated(
    settings: EgoMotionSettings,
    devices: Mapping[str, DeviceIdentity],
    recorded: Mapping[str, Any],
    folder: Path | None,
) -> CalibratedSettings:
    """Return settings with what is known of the recording's gyro and accelerometer.

    Args:
        settings: what holds where nothing was measured.
        devices: which "gyro" and "accelerometer" the recording is of.
        recorded: the recording's "calibration_files", contents by name.
        folder: of further files, which go before those; None = none.

    Raises:
        MappingError: a recorded file was measured on another device, two files are of one device,
            or a file cannot be read.
    """
    notes, warnings = [], []
    named = [
        parse_inertial(json.dumps(content), f"the recording's {name}")
        for name, content in recorded.items()
        if isinstance(content, dict) and content.get("schema") == "terravibe/inertial"
    ]
    for part, device in devices.items():
        found = _of_device(folder, part, device) if folder is not None else None
        found = found or _recorded(named, part, device)
        if found is None:
            notes.append(f"{part}: sigmas are the settings' (no calibration)")
            continue
        source, file = found
        notes.append(f"{part}: sigmas from {source}, measured on {_name(file.device)}")
        if part == "gyro" and file.gyro is not None:
            settings = _with_gyro(settings, file.gyro)
            warnings += _doubts(part, file.gyro)
        elif file.accelerometer is not None:
            settings = _with_accelerometer(settings, file.accelerometer)
    return CalibratedSettings(settings, tuple(notes), tuple(warnings))


def _of_device(folder: Path, part: str, device: DeviceIdentity) -> tuple[str, InertialFile] | None:
    """Return the one file of a folder that was measured on that device, and its name."""
    if not folder.is_dir():
        raise MappingError(f"there is no folder {folder}; expected calibration files in it")
    found = []
    for path in sorted(folder.glob("*.json")):
        text = read_whole(path).decode("utf-8", errors="replace")
        if device.serial and _SCHEMA in text:
            file = parse_inertial(text, str(path))
            if file.device.serial == device.serial and getattr(file, part) is not None:
                found.append((str(path), file))
    if len(found) > 1:
        names = " and ".join(name for name, _ in found)
        raise MappingError(f"{names} are both of {part} {device.serial}; keep one")
    return found[0] if found else None


def _recorded(
    files: list[InertialFile], part: str, device: DeviceIdentity
) -> tuple[str, InertialFile] | None:
    """Return the one of a recording's files that may be of that device; its own goes first."""
    known = [file for file in files if getattr(file, part) is not None]
    own = [file for file in known if device.serial and file.device.serial == device.serial]
    fitting = own or [file for file in known if not (file.device.serial and device.serial)]
    if known and not fitting:
        raise MappingError(
            f"the recording's calibration was measured on {_name(known[0].device)}, its {part} is "
            f"{_name(device)}; calibrate that device, or give --calibrations with its file"
        )
    if len(own) > 1:
        raise MappingError(
            f"the recording has {len(own)} calibrations of {part} {device.serial}; give "
            "--calibrations with one file of it"
        )
    return ("the recording", fitting[-1]) if fitting else None


def _name(device: DeviceIdentity) -> str:
    return f"{device.model} {device.serial}".strip() or "a device that it does not name"


def _with_gyro(settings: EgoMotionSettings, gyro: GyroCalibration) -> EgoMotionSettings:
    changes: dict[str, float] = {}
    instability = 0.0
    if gyro.noise is not None:
        instability = gyro.noise.bias_instability.value
        white, walk = gyro.noise.white_per_sqrt_hz.value, gyro.noise.random_walk_sqrt_hz.value
        if white > 0.0:
            changes["gyro_noise_rad_s_per_sqrt_hz"] = math.sqrt(2.0) * white
        changes["gyro_bias_walk_rad_s_per_sqrt_s"] = max(walk, 0.0)
    if gyro.bias_rad_s is not None:
        drift = 0.0 if gyro.bias_per_c is None else gyro.bias_per_c.value * _TEMPERATURE_C
        sigma = gyro.bias_rad_s.sigma or 0.0
        changes["gyro_zero_rad_s"] = gyro.bias_rad_s.value
        changes["gyro_bias_rad_s"] = math.hypot(sigma, instability, drift, _SWITCH_ON_RAD_S)
    if gyro.scale is not None:
        changes["gyro_scale"] = gyro.scale.value
        changes["gyro_scale_sigma"] = gyro.scale.sigma or 0.0
    return replace(settings, **changes)  # type: ignore[arg-type] # none of them is the bool


def _with_accelerometer(
    settings: EgoMotionSettings, found: AccelerometerCalibration
) -> EgoMotionSettings:
    changes: dict[str, float] = {}
    axes = "xyz"
    if found.bias_m_s2 is not None:
        sigmas = [bias.sigma or 0.0 for bias in found.bias_m_s2]
        wander = [part.bias_instability.value for part in found.noise or ()]
        tilt_rad = math.hypot(max(sigmas), max(wander, default=0.0)) / settings.gravity_m_s2
        changes["levelling_bias_rad"] = math.hypot(tilt_rad, _MOUNT_RAD)
        changes |= {
            f"force_zero_{axis}_m_s2": bias.value
            for axis, bias in zip(axes, found.bias_m_s2, strict=True)
        }
    if found.scale is not None:
        changes |= {
            f"force_scale_{axis}": scale.value
            for axis, scale in zip(axes, found.scale, strict=True)
        }
    if found.crooked_rad is not None:
        xy, xz, yz = found.crooked_rad
        changes["force_crooked_xy_rad"] = xy
        changes["force_crooked_xz_rad"] = -xz  # the file has T's entry, the settings minus it
        changes["force_crooked_yz_rad"] = yz
    return replace(settings, **changes)  # type: ignore[arg-type] # none of them is the bool


def _doubts(part: str, gyro: GyroCalibration) -> list[str]:
    """Return what the calibration does not hold for."""
    if gyro.noise is None or gyro.noise.duration_s >= _LONG_ENOUGH_S:
        return []
    hours = gyro.noise.duration_s / 3600.0
    return [
        f"the {part}'s bias walk was measured in {hours:.1f} h; below 2 h it comes out too large"
    ]
