"""Parsers of command-line values."""

from __future__ import annotations

import argparse
from collections.abc import Callable


def numbers(count: int, form: str) -> Callable[[str], tuple[float, ...]]:
    """Return a parser of `count` comma-separated numbers; `form` describes them in the error."""

    def parse(text: str) -> tuple[float, ...]:
        try:
            values = tuple(float(part) for part in text.split(","))
        except ValueError:
            values = ()
        if len(values) != count:
            raise argparse.ArgumentTypeError(f"found {text!r}, expected {form}")
        return values

    return parse
