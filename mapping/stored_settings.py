"""Settings as plain values, and back: in recordings, map files and worlds."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from typing import TYPE_CHECKING, TypeVar

from mapping.errors import MappingError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_Settings = TypeVar("_Settings", bound="DataclassInstance")


def overlaid(settings: _Settings, section: object, given: frozenset[str], where: str) -> _Settings:
    """Return a dataclass of settings with the values of a JSON object, but for those `given`.

    Raises:
        MappingError: it is no object, or has an unknown key or a value of another type.
    """
    known = {item.name for item in fields(settings)}
    if not isinstance(section, dict) or not section.keys() <= known:
        raise MappingError(f"{where} is {section!r}; expected known settings")
    recorded = {name: value for name, value in section.items() if name not in given}
    for name, value in recorded.items():
        ours = getattr(settings, name)
        if is_dataclass(ours) and not isinstance(ours, type):
            recorded[name] = overlaid(ours, value, frozenset(), f"{where}, {name},")
        elif _kind(value) is not _kind(ours):
            raise MappingError(f"{where} has {name} = {value!r}")
    return replace(settings, **recorded)


def _kind(value: object) -> type:
    """Return the JSON type of a value: all numbers are one, and tuples are lists."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float
    return list if isinstance(value, tuple) else type(value)


def flat(name: str, value: object) -> Iterator[tuple[str, str | int | float]]:
    """Yield the leaves of nested settings under names joined by underscores."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from flat(f"{name}_{key}", inner)
    elif isinstance(value, tuple | list):
        yield name, json.dumps(value)
    elif isinstance(value, str | int | float):
        yield name, int(value) if isinstance(value, bool) else value
