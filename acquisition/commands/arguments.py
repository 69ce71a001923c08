"""Parsers of command-line values."""

from __future__ import annotations

import argparse
from collections.abc import Callable


def numbers(count: int | None, form: str) -> Callable[[str], tuple[float, ...]]:
    """Return a parser of comma-separated numbers; `form` describes them in the error.

    `count`: how many there must be; None for any number.
    """

    def parse(text: str) -> tuple[float, ...]:
        try:
            values = tuple(float(part) for part in text.split(","))
        except ValueError:
            values = ()
        if not values or len(values) != (count or len(values)):
            raise argparse.ArgumentTypeError(f"found {text!r}, expected {form}")
        return values

    return parse
