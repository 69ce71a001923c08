"""Which depth noise model a recording is mapped with, and why it is that one."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mapping.calibration_file import (
    DEPTH_NOISE_SCHEMA,
    Calibration,
    DeviceIdentity,
    parse_calibration,
)
from mapping.errors import MappingError
from mapping.files import read_whole
from mapping.noise import KINECT_V1, DepthNoiseModel


@dataclass(frozen=True, slots=True)
class ChosenNoise:
    """A noise model, and where it comes from.

    Attributes:
        model: of the depth camera.
        source: a file or preset, "the recording's depth_noise", or "default".
        fallback: model at the distances where `model` was not measured; None = not needed.
        warning: one line when a calibration was looked for and none is used; else "".
    """

    model: DepthNoiseModel
    source: str
    fallback: DepthNoiseModel | None = None
    warning: str = ""

    def attributes(self) -> dict[str, str | int | float]:
        """Return what a map file says of the choice."""
        said: dict[str, str | int | float] = {"noise_source": self.source}
        return said | ({"noise_warning": self.warning} if self.warning else {})


def choose_noise(
    given: DepthNoiseModel | Calibration | None,
    folder: Path | None,
    recorded: Mapping[str, Any],
    device: DeviceIdentity,
) -> ChosenNoise:
    """Return the user's noise, else that of the device, else the recording's own, else the default.

    Args:
        given: what the user names; goes before all else.
        folder: of calibration files, from which that of the device is taken.
        recorded: the settings that the recording was made with.
        device: the recording's depth camera.

    Raises:
        MappingError: a model was measured on another device, or cannot be read.
    """
    if isinstance(given, DepthNoiseModel):
        return ChosenNoise(given, given.name)
    calibration, missing = given, ""
    if calibration is None and folder is not None:
        there = calibrations_in(folder)
        calibration = calibration_for(there, device)
        missing = "" if calibration else _missing(folder, there, device)
    if calibration is None and "depth_noise" in recorded:
        text = json.dumps(recorded["depth_noise"])
        calibration = parse_calibration(text, "the recording's depth_noise")
    elif calibration is None and not missing:
        missing = _misplaced(recorded, device)
    if calibration is None:
        return ChosenNoise(KINECT_V1, "default", warning=_used(missing, KINECT_V1, "default"))
    calibration.check_device(device)
    # Measured in a box of distances: outside it the default model stands in.
    fallback = KINECT_V1 if calibration.measured else None
    warning = _used(missing, calibration.model, calibration.where)
    return ChosenNoise(calibration.model, calibration.where, fallback, warning)


def calibrations_in(folder: Path) -> list[Calibration]:
    """Return the depth calibrations in a folder of .json files, by name.

    Raises:
        MappingError: the folder or a file in it cannot be read.
    """
    if not folder.is_dir():
        raise MappingError(f"there is no folder {folder}; expected calibration files in it")
    texts = {
        path: read_whole(path).decode("utf-8", errors="replace")
        for path in sorted(folder.glob("*.json"))
    }
    return [
        parse_calibration(text, str(path))
        for path, text in texts.items()
        if f'"{DEPTH_NOISE_SCHEMA}"' in text
    ]


def calibration_for(there: Sequence[Calibration], device: DeviceIdentity) -> Calibration | None:
    """Return the one calibration of a device; None without one or without a serial number.

    Raises:
        MappingError: two are of the device.
    """
    found = [c for c in there if device.serial and c.device.serial == device.serial]
    if len(found) > 1:
        raise MappingError(
            f"{' and '.join(c.where for c in found)} are both of device {device.serial}; keep one"
        )
    return found[0] if found else None


def _misplaced(recorded: Mapping[str, Any], device: DeviceIdentity) -> str:
    """Say that the recording has depth calibrations where those of other sensors belong."""
    files = recorded.get("calibration_files")
    names = [
        name
        for name, content in (files.items() if isinstance(files, dict) else ())
        if isinstance(content, dict) and content.get("schema") == DEPTH_NOISE_SCHEMA
    ]
    if not names:
        return ""
    return (
        f"the recording's rover.toml names no depth_noise for {_name(device)}; it has "
        f"{', '.join(names)} among others, where nobody looks"
    )


def _missing(folder: Path, there: Sequence[Calibration], device: DeviceIdentity) -> str:
    """Say which device was looked for, and which are there."""
    wanted = _name(device) if device.serial else f"{_name(device)}, which has no serial number"
    names = ", ".join(f"{Path(c.where).name} of {_name(c.device)}" for c in there)
    return f"no depth calibration of {wanted}, in {folder}: {names or 'none of any device'}"


def _used(missing: str, model: DepthNoiseModel, source: str) -> str:
    return f"{missing}; noise model {model.name} ({source}) is used" if missing else ""


def _name(device: DeviceIdentity) -> str:
    return f"{device.model} {device.serial}".strip() or "a device that it does not name"
