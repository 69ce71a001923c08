"""What a recording says about its own making: settings, software, host and sources."""

from __future__ import annotations

import json
import platform
import socket
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import cache
from importlib.metadata import PackageNotFoundError, version

from acquisition.errors import StreamError
from drivers.source import SourceInfo

# The name of the MCAP metadata record.
METADATA_NAME = "terravibe"
SOURCE_PREFIX = "source."
# In "settings": what the user knows about the clock of each source, by name.
DEVICE_CLOCKS = "device_clocks"
_LIBRARIES = ("terravibe", "numpy", "mcap", "rosbags")


@cache
def software_versions() -> Mapping[str, str]:
    """Return the version of Python and of each library that shapes the bytes.

    Looked up once: what is installed may change while this program runs, and each look leaves
    hundreds of objects in cycles, which a recorder in many parts would gather.
    """
    return {"python": platform.python_version(), **{name: _version(name) for name in _LIBRARIES}}


def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return "not installed"


def provenance(sources: Sequence[SourceInfo], settings: Mapping[str, object]) -> dict[str, str]:
    """Return the metadata record: "settings", "versions", "host" and "source.NAME", as JSON.

    Raises:
        StreamError: the settings are not JSON.
    """
    record = {
        "settings": _json("settings", dict(settings)),
        "versions": _json("versions", dict(software_versions())),
        "host": socket.gethostname(),
    }
    for info in sources:
        record[SOURCE_PREFIX + info.name] = _json(info.name, _identity(info))
    return record


def _identity(info: SourceInfo) -> dict[str, object]:
    return {
        "model": info.model,
        "serial": info.serial,
        "produces": [kind.__name__ for kind in info.produces],
        "time_base": info.time_base,
        "details": dict(info.details),
        "nominal_rate_hz": {kind.__name__: hz for kind, hz in info.nominal_rate_hz.items()},
        "counter": asdict(info.counter) if info.counter else None,
    }


def _json(what: str, value: object) -> str:
    try:
        return json.dumps(value, sort_keys=True, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise StreamError(f"cannot record {what} as JSON: {error}") from error
