"""The settings in a [[devices]] block, held against what the driver of that kind takes."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

from pydantic import ConfigDict, TypeAdapter, ValidationError

from acquisition.config.suggestion import suggestion
from drivers.source import Source

# A text is no number, and a number no text; settings are finite.
_RULES = ConfigDict(strict=True, allow_inf_nan=False, arbitrary_types_allowed=True)


def problems_of(factory: Callable[..., Source], given: Mapping[str, object]) -> Iterator[str]:
    """Give what is wrong with settings for this driver: unknown, missing, or of another type.

    Args:
        factory: the driver's class; its annotations say what it takes.
        given: the settings of the file, by name.
    """
    takes = _settings_of(factory)
    for name in (name for name in given if name not in takes):
        hint = suggestion(name, takes) or f"expected {', '.join(takes)}"
        yield f"unknown setting {name}; {hint}"
    for name, (kind, is_needed) in takes.items():
        if name in given:
            yield from _type_problem(name, kind, given[name])
        elif is_needed:
            yield f"{name} is missing"


def _type_problem(name: str, kind: type[object], value: object) -> Iterator[str]:
    try:
        TypeAdapter(kind, config=_RULES).validate_python(value)
    except ValidationError as error:
        reasons = " or ".join(problem["msg"] for problem in error.errors(include_url=False))
        yield f"{name}: {reasons}, found {value!r}"


def with_paths_from(
    factory: Callable[..., Source], given: Mapping[str, object], folder: Path
) -> dict[str, object]:
    """Return settings whose relative paths are those of files beside rover.toml.

    A text that names nothing there stays as it is: it may be the name of something shipped.
    """
    takes = _settings_of(factory)
    settings = dict(given)
    for name, value in given.items():
        is_path = name in takes and Path in get_args(takes[name][0])
        if is_path and isinstance(value, str) and value and (folder / value).exists():
            settings[name] = folder / value
    return settings


def _settings_of(factory: Callable[..., Source]) -> dict[str, tuple[type[object], bool]]:
    """Return name -> (type, whether it must be given); clocks and sleepers are for tests."""
    hints: dict[str, Any] = get_type_hints(factory.__init__)
    return {
        name: (hints[name], parameter.default is parameter.empty)
        for name, parameter in inspect.signature(factory).parameters.items()
        if get_origin(hints[name]) is not Callable
    }
