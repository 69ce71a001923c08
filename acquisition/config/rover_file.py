"""rover.toml: read it, and say file and line of what is wrong with it."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from operator import itemgetter
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from acquisition.config.model import TABLES, RoverConfig
from acquisition.config.suggestion import suggestion
from acquisition.errors import ConfigError
from drivers.errors import reason_of
from drivers.toml_lines import line_of, line_of_syntax_error, lines_of_keys

# Where pydantic speaks of Python instead of TOML.
_EXPECTED = {
    "model_type": "expected a table",
    "path_type": "expected a text in quotes",
    "string_pattern_mismatch": "expected letters, digits, - and _, a letter or digit first",
    "tuple_type": "expected a list in [ ]",
}


@dataclass(frozen=True, slots=True)
class LoadedConfig:
    """A configuration and the file that it came from; relative paths are relative to that."""

    config: RoverConfig
    path: Path
    text: str

    def resolve(self, path: Path) -> Path:
        """Return a path of the configuration as one that can be opened from anywhere."""
        return self.path.parent / path

    def where(self, *key: str | int) -> str:
        """Return "FILE:LINE: KEY" for messages."""
        return f"{self.path}:{line_of(key, lines_of_keys(self.text))}: {_dotted(key)}"


def default_text() -> str:
    """Return a rover.toml that explains every key and sets it to its default."""
    return files("acquisition.config").joinpath("rover.toml").read_text(encoding="utf-8")


def load(path: Path) -> LoadedConfig:
    """Read a configuration.

    Raises:
        ConfigError: unreadable, no TOML, or a key or value that is not expected; with file and
            line of the first problem, and the number of the others.
    """
    return parse(read(path), path)


def read(path: Path) -> str:
    """Return the file's text.

    Raises:
        ConfigError: it is not there, or no text.
    """
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        hint = "; `terravibe config init` makes one" if isinstance(error, FileNotFoundError) else ""
        raise ConfigError(f"cannot read {path}: {error.strerror}{hint}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"cannot read {path}: {reason_of(error)}; give a rover.toml") from error


def parse(text: str, path: Path) -> LoadedConfig:
    """Return the configuration in `text`, which was found at `path`; raises as `load` does."""
    if problems := problems_in(text, path):
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise ConfigError(problems[0] + more)
    return LoadedConfig(RoverConfig.model_validate(tomllib.loads(text)), path, text)


def problems_in(text: str, path: Path) -> list[str]:
    """Return what no rover.toml may say, each as "FILE:LINE: KEY: what is wrong", by line."""
    try:
        RoverConfig.model_validate(tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        return [f"{path}:{line_of_syntax_error(error, text)}: not TOML: {error}"]
    except ValidationError as error:
        return _problems(error, path, text)
    return []


def _problems(error: ValidationError, path: Path, text: str) -> list[str]:
    lines = lines_of_keys(text)
    found = [
        (line_of(problem["loc"], lines), problem["loc"], _reason(problem))
        for problem in error.errors(include_url=False)
    ]
    found.sort(key=itemgetter(0))
    return [f"{path}:{line}: {_dotted(key)}: {reason}" for line, key, reason in found]


def _reason(problem: Mapping[str, Any]) -> str:
    if problem["type"] == "extra_forbidden":
        return "; ".join(part for part in ("unknown key", _hint(problem["loc"])) if part)
    if problem["type"] == "missing":
        return "is missing"
    if problem["type"] == "value_error":  # raised by the model; it says what was found
        return str(problem["ctx"]["error"])
    if problem["type"] == "tuple_type" and isinstance(problem["input"], dict):
        return f"expected [[{problem['loc'][-1]}]] with two brackets, one block for each"
    expected = _EXPECTED.get(problem["type"], problem["msg"])
    return f"{expected}, found {problem['input']!r}"


def _hint(key: tuple[str | int, ...]) -> str:
    """Return what an unknown key may have been meant for: one of its own table, or of another."""
    own = ".".join(part for part in key[:-1] if isinstance(part, str))
    table = TABLES["mounts" if own.startswith("mounts.") else own]
    name = str(key[-1])
    places = [f"{other}.{name}" for other in TABLES if name in TABLES[other].model_fields]
    return suggestion(name, table.model_fields) or suggestion(name, places, likeness=0.0)


def _dotted(key: tuple[str | int, ...]) -> str:
    return ".".join(map(str, key)) or "the file"
