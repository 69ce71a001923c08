"""Profile files of vibration sensors: find, read, check.

A profile is data: serial settings, frame layout, meaning of the fields. Shipped profiles lie in
`drivers/vibration/profiles/`; any other is a path to a TOML file.
"""

from __future__ import annotations

import reprlib
import tomllib
from dataclasses import dataclass
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from drivers.errors import DriverError, reason_of
from drivers.toml_lines import KeyPath, line_of, line_of_syntax_error, lines_of_keys
from drivers.vibration.profile_rules import Finding, findings
from drivers.vibration.profile_tables import VibrationProfile


@dataclass(frozen=True, slots=True)
class ProfileProblem:
    """One fault in a profile file; `str` gives `FILE:LINE: found ..., expected ..., do ...`."""

    file: str
    line: int
    found: str
    expected: str
    do: str

    def __str__(self) -> str:
        return (
            f"{self.file}:{self.line}: found {self.found}, expected {self.expected}, do: {self.do}"
        )


def shipped_profiles() -> tuple[str, ...]:
    """Return the names of the profiles that come with terravibe."""
    files = _shipped_folder().iterdir()
    return tuple(sorted(f.name.removesuffix(".toml") for f in files if f.name.endswith(".toml")))


def load_profile(name_or_path: str | Path) -> VibrationProfile:
    """Return a shipped profile by its name, or the profile in a file.

    Raises:
        DriverError: there is no such profile, or it has a fault; the message names the first.
    """
    label, text = _read(name_or_path)
    profile, problems = _parse(label, text)
    if profile is None:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise DriverError(f"{problems[0]}{more}")
    return profile


def check_profile(path: str | Path) -> list[ProfileProblem]:
    """Return every fault in a profile file, in the order of its lines; none when it is usable.

    Whether the tables agree with each other is checked once each of them is well formed.

    Raises:
        DriverError: there is no such profile.
    """
    return _parse(*_read(path))[1]


def _shipped_folder() -> Traversable:
    return resources.files("drivers.vibration") / "profiles"


def _read(name_or_path: str | Path) -> tuple[str, str]:
    """Return what to call the file in messages, and its text."""
    shipped = _shipped_folder() / f"{name_or_path}.toml"
    if str(name_or_path) in shipped_profiles():
        return f"{name_or_path}.toml", shipped.read_text(encoding="utf-8")
    try:
        return str(name_or_path), Path(name_or_path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DriverError(
            f"no vibration profile {str(name_or_path)!r} ({reason_of(error)}); "
            f"expected one of {', '.join(shipped_profiles())} or the path of a TOML file"
        ) from error


def _parse(label: str, text: str) -> tuple[VibrationProfile | None, list[ProfileProblem]]:
    try:
        tables = _frozen(tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        line = line_of_syntax_error(error, text)
        return None, [ProfileProblem(label, line, str(error), "valid TOML", "correct the line")]
    try:
        profile = VibrationProfile.model_validate(tables)
    except ValidationError as error:
        found = [_finding(details) for details in error.errors()]
    else:
        found = findings(profile)
        if not found:
            return profile, []
    lines = lines_of_keys(text)
    problems = [
        ProfileProblem(label, line_of(f.path, lines), f.found, f.expected, f.do) for f in found
    ]
    return None, sorted(problems, key=lambda problem: problem.line)


def _frozen(value: object) -> object:
    """Return TOML's lists as tuples, so that a profile cannot be changed after it is read."""
    if isinstance(value, dict):
        return {key: _frozen(child) for key, child in value.items()}
    return tuple(_frozen(child) for child in value) if isinstance(value, list) else value


def _finding(details: ErrorDetails) -> Finding:
    """Put a fault that pydantic found into the words of a profile's author."""
    path: KeyPath = details["loc"]
    key = path[-1]
    table = ".".join(str(part) for part in path[:-1] if isinstance(part, str)) or "the top level"
    match details["type"]:
        case "missing":
            return Finding(path, f"no {key!r} in {table}", f"the key {key!r}", "add it")
        case "extra_forbidden":
            return Finding(
                path,
                f"unknown key {key!r} in {table}",
                "keys of docs/devices/vibration.md",
                "correct the spelling or remove it",
            )
    expected = details["msg"].removeprefix("Input should be ")
    return Finding(path, f"{key} = {reprlib.repr(details['input'])}", expected, "correct the value")
