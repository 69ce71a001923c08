"""What a recording says of itself: the settings that it was made with, and its devices."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from acquisition.stream.provenance import METADATA_NAME
from mapping.calibration_file import DeviceIdentity
from mapping.errors import MappingError


def recorded_settings(metadata: Mapping[str, Mapping[str, str]]) -> dict[str, Any]:
    """Return the settings that the recording was made with; empty for others' recordings.

    Raises:
        MappingError: they are there but are not a JSON object.
    """
    text = metadata.get(METADATA_NAME, {}).get("settings", "{}")
    try:
        settings = json.loads(text)
    except json.JSONDecodeError as error:
        raise MappingError(f"the recording's settings are not JSON: {error}") from error
    if not isinstance(settings, dict):
        raise MappingError("the recording's settings are not a JSON object")
    return settings


def depth_device(metadata: Mapping[str, Mapping[str, str]]) -> DeviceIdentity:
    """Return which device a recording's depth frames come from, as far as it says so.

    Raises:
        MappingError: as `recorded_device`.
    """
    return recorded_device(metadata, "DepthFrame")


def depth_devices(metadata: Mapping[str, Mapping[str, str]]) -> tuple[DeviceIdentity, ...]:
    """Return all devices that depth frames come from: several in a merged recording.

    Raises:
        MappingError: as `recorded_device`.
    """
    records = [record for name, record in metadata.items() if _is_provenance(name)]
    devices: list[DeviceIdentity] = []
    for device in (depth_device({METADATA_NAME: record}) for record in records):
        if device not in (*devices, DeviceIdentity()):
            devices.append(device)
    return tuple(devices)


def _is_provenance(name: str) -> bool:
    """Tell whether a metadata record says who recorded; merged ones have a file's name behind."""
    return name == METADATA_NAME or name.startswith(f"{METADATA_NAME} (")


def recorded_device(metadata: Mapping[str, Mapping[str, str]], *samples: str) -> DeviceIdentity:
    """Return which device a recording's samples of some types come from, as far as it says so.

    Raises:
        MappingError: what it says of its sources is not a JSON object.
    """
    for name, text in metadata.get(METADATA_NAME, {}).items():
        if not name.startswith("source."):
            continue
        try:
            identity = dict(json.loads(text))
        except (ValueError, TypeError) as error:
            raise MappingError(f"the recording's {name} is not a JSON object: {error}") from error
        if set(samples) & set(identity.get("produces", ())):
            model, serial = (str(identity.get(key, "")) for key in ("model", "serial"))
            return DeviceIdentity(model=model, serial=serial)
    return DeviceIdentity()
