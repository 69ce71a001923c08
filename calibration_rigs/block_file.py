"""Blocks for rover.toml, in files of their own: they replace no file that holds anything else."""

from __future__ import annotations

import tomllib
from collections.abc import Collection, Iterator
from pathlib import Path

from acquisition.files import check_target
from calibration_rigs.errors import RigError

_NAMED_AT_MOST = 3


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


def _names(path: Path) -> set[str]:
    """Return the settings of a TOML file, tables without any among them, with dots in between.

    Raises:
        RigError: it is none, or cannot be read.
    """
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
