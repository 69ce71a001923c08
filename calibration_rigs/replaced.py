"""What the products of a rig may replace: earlier products of their own kind.

Nothing heavy is imported before a command runs.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from calibration_rigs.errors import RigError

IsKind = Callable[[bytes], bool]


def check_replaced(path: Path, kind: str, is_kind: IsKind) -> None:
    """Refuse a file that a product must not replace, before the work for it begins.

    Args:
        path: where the product is to go; what is not there, or empty, is free.
        kind: what the product is, for the message.
        is_kind: tells from the content of a file whether it is such a product.

    Raises:
        RigError: there is something else at `path`, or what is there cannot be read.
        StreamError: it cannot be written.
    """
    from acquisition.files import check_target

    check_target(path)
    if not path.exists():
        return
    try:
        content = path.read_bytes()
    except OSError as error:
        raise RigError(
            f"{path} is there and cannot be read: {error.strerror}; give a new name"
        ) from error
    if content and not is_kind(content):
        raise RigError(
            f"{path} is there and is no {kind}, which alone is replaced; give another name or "
            "folder, or move that file away"
        )


def of_schema(schema: str) -> IsKind:
    """Return what tells the JSON files that say they are of a schema, of any version."""

    def is_kind(content: bytes) -> bool:
        """Tell whether it is JSON of that schema."""
        try:
            found = json.loads(content)
        except ValueError:
            return False
        return isinstance(found, dict) and found.get("schema") == schema

    return is_kind


def of_table(columns: str) -> IsKind:
    """Return what tells the CSV files with that first line."""
    return lambda content: content.split(b"\n", 1)[0].rstrip(b"\r") == columns.encode()
