"""The output of a calibration whose result is a block of rover.toml.

The block goes into a file of its own, which replaces no file that holds anything else. Nothing
heavy is imported before a command runs.
"""

from __future__ import annotations

import argparse
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Protocol

from acquisition.commands.arguments import product
from acquisition.commands.console import Console, Describable, show
from calibration_rigs.errors import RigError

_NAMED_AT_MOST = 3


class Block(Describable, Protocol):
    """A result that rover.toml can hold."""

    def toml(self) -> str:
        """Return the block."""


def add_block_output(parser: argparse.ArgumentParser) -> None:
    """Declare where the block goes."""
    parser.add_argument(
        "-o",
        "--output",
        type=product(".toml"),
        required=True,
        metavar="FILE.toml",
        help="a block to put into rover.toml",
    )


def check_block_target(path: Path, table: str, keys: Collection[str]) -> None:
    """Refuse a file that a block must not replace, before the work for it begins.

    An earlier block of the same kind, or an empty file, is replaced.

    Args:
        path: where the block is to go.
        table: the block's table, with dots between its names.
        keys: those that such a block may hold.

    Raises:
        RigError: there is something else at `path`, such as the whole rover.toml.
        StreamError: it cannot be written.
    """
    from acquisition.files import check_target

    check_target(path)
    if not path.exists() or path.stat().st_size == 0:
        return
    found = _names(path)
    others = sorted(found - {table, *(f"{table}.{key}" for key in keys)})
    if found and not others:
        return
    what = "no settings" if not others else ", ".join(others[:_NAMED_AT_MOST])
    more = f" and {len(others) - _NAMED_AT_MOST} more" if len(others) > _NAMED_AT_MOST else ""
    raise RigError(
        f"{path} is there and holds {what}{more}, where only an earlier [{table}] is "
        "replaced; give -o a new name, and put the block into rover.toml from there"
    )


def write_block(options: argparse.Namespace, console: Console, result: Block) -> None:
    """Write the block, and print the result in the form that was asked for.

    Raises:
        MappingError: the file cannot be written.
    """
    from mapping.files import write_whole

    write_whole(options.output, result.toml().encode())
    show(console, result, as_json=options.json)


def _names(path: Path) -> set[str]:
    """Return the settings of a TOML file, tables without any among them, with dots in between.

    Raises:
        RigError: it is none, or cannot be read.
    """
    import tomllib

    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise RigError(f"{path} is there and is no TOML file ({error}); give a new name") from error
    except OSError as error:
        raise RigError(
            f"{path} is there and cannot be read: {error.strerror}; give a new name"
        ) from error
    return set(_leaves(content, ""))


def _leaves(table: dict[str, object], prefix: str) -> Iterator[str]:
    for key, value in table.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict) and value:
            yield from _leaves(value, f"{name}.")
        else:
            yield name
