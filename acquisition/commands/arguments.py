"""Parsers of command-line values."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from math import inf, isfinite
from pathlib import Path


def numbers(count: int | None, form: str) -> Callable[[str], tuple[float, ...]]:
    """Return a parser of comma-separated finite numbers; `form` describes them in the error.

    `count`: how many there must be; None for any number.
    """

    def parse(text: str) -> tuple[float, ...]:
        """Return the numbers; argparse tells what is wrong with them."""
        try:
            values = tuple(float(part) for part in text.split(","))
        except ValueError:
            values = ()
        if not values or len(values) != (count or len(values)) or not all(map(isfinite, values)):
            raise argparse.ArgumentTypeError(f"found {text!r}, expected {form}")
        return values

    return parse


def seconds(text: str) -> float:
    """Parse a time that somebody may wait for: 0 s to 30 years."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= 1e9:  # NaN too
        raise argparse.ArgumentTypeError(f"found {text!r}, expected seconds, 0 to 1e9")
    return value


def names(text: str) -> tuple[str, ...]:
    """Parse names that commas separate."""
    found = tuple(part.strip() for part in text.split(","))
    if not all(found):
        raise argparse.ArgumentTypeError(f"found {text!r}, expected names with commas between")
    return found


def milliseconds(text: str) -> float:
    """Parse a time lag that may be of either sign: a minute at most."""
    try:
        value = float(text)
    except ValueError:
        value = inf
    if not -6e4 <= value <= 6e4:  # NaN too
        raise argparse.ArgumentTypeError(f"found {text!r}, expected milliseconds, to 60000")
    return value


def product(suffix: str) -> Callable[[str], Path]:
    """Return a parser of the name of a file to be written, which must end in `suffix`.

    A map that is called map.tif, or a recording called run.nc, is found out too late.
    """

    def parse(text: str) -> Path:
        """Return the name if it ends as it should."""
        if Path(text).suffix != suffix:
            raise argparse.ArgumentTypeError(f"found {text!r}, expected a name ending in {suffix}")
        return Path(text)

    return parse
