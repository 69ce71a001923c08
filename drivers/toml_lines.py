"""The line on which each key of a TOML text stands; `tomllib` does not tell.

The text is parsed again and again, one line longer each time. A prefix that ends inside a
multi-line value does not parse, so a statement's keys appear exactly when the statement is
complete, and `tomllib` itself decides what a statement is. Quadratic, hence for reporting
problems only: 200 lines take about 0.1 s.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping

KeyPath = tuple[str | int, ...]


def lines_of_keys(text: str) -> dict[KeyPath, int]:
    """Return key path -> line number, counted from 1; `text` must be valid TOML.

    A path names tables and keys by str and elements of arrays by int: ("field", 2, "offsets").
    """
    found: dict[KeyPath, int] = {(): 1}
    statement_starts = 1
    lines = text.splitlines()
    for count in range(1, len(lines) + 1):
        try:
            parsed = tomllib.loads("\n".join(lines[:count]))
        except tomllib.TOMLDecodeError:
            continue
        for path in _paths(parsed):
            found.setdefault(path, statement_starts)
        statement_starts = count + 1
    return found


def line_of(path: KeyPath, lines: Mapping[KeyPath, int]) -> int:
    """Return the line, from 1, of the key, or of the nearest table above that is written."""
    while path not in lines:
        path = path[:-1]
    return lines[path]


def line_of_syntax_error(error: tomllib.TOMLDecodeError, text: str) -> int:
    """Return the line, counted from 1, that a parse error speaks of."""
    match = re.search(r"at line (\d+)", str(error))
    return int(match[1]) if match else max(1, len(text.splitlines()))


def _paths(value: object, above: KeyPath = ()) -> Iterator[KeyPath]:
    """Yield the path of every key and array element in the parsed value."""
    children: Iterable[tuple[str | int, object]] = ()
    if isinstance(value, dict):
        children = value.items()
    elif isinstance(value, list):
        children = enumerate(value)
    for key, child in children:
        yield (*above, key)
        yield from _paths(child, (*above, key))
