"""A finished file or none: products appear under their name only when they are complete."""

from __future__ import annotations

import errno
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from acquisition.errors import StreamError

# These concern what is written, whatever else was read meanwhile.
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path`; on success it is synchronised and takes that name.

    The temporary path has the same suffix, for libraries that choose the format by it. Whatever
    goes wrong, including an interrupt, removes the temporary file and leaves an older file at
    `path` as it was.

    Raises:
        StreamError: the folder is missing or not writable, `path` is there and no ordinary file,
            there is no room for it, or the file system refuses the last step; names the path and
            the cause.
    """
    check_target(path)
    temporary = path.with_name(f".{path.stem}.{secrets.token_hex(4)}.part{path.suffix}")
    try:
        yield temporary
        _take_place(temporary, path)
    except (StreamError, OSError) as error:
        if (told := _as_users_know_it(error, temporary, path)) is None:
            raise
        raise told from error
    finally:
        temporary.unlink(missing_ok=True)


def _as_users_know_it(
    error: StreamError | OSError, temporary: Path, path: Path
) -> StreamError | None:
    """Say it without the hidden name, and with what to do without room; None where it is said."""
    cause = error.__cause__ if isinstance(error, StreamError) else error
    if isinstance(cause, OSError) and cause.errno in _NO_ROOM:
        return StreamError(
            f"cannot write {path}: {cause.strerror}; make room, or write to another disk"
        )
    if isinstance(error, StreamError) and str(temporary) in str(error):
        return StreamError(str(error).replace(str(temporary), str(path)))
    return None


def refuse_same_file(path: Path, other: Path) -> None:
    """Refuse to use one file as two.

    Raises:
        StreamError: both names lead to the same file.
    """
    if path.resolve() == other.resolve() or (
        path.exists() and other.exists() and path.samefile(other)
    ):
        raise StreamError(f"{other} and {path} are the same file; give another name")


def refuse_existing(path: Path) -> None:
    """Refuse to replace a file: recordings cannot be made again.

    Raises:
        StreamError: there is one.
    """
    if path.is_file():
        raise StreamError(f"{path} exists already; give another name, or remove it first")


def written_name(path: Path) -> str:
    """Return the name of a file as text for a recording; bytes that are no UTF-8 as "\\xff"."""
    return os.fsencode(path.name).decode("utf-8", "backslashreplace")


def check_target(path: Path) -> None:
    """Refuse a product that could not be written, before the work for it begins.

    Raises:
        StreamError: the folder is missing or not writable, or `path` is there and no ordinary
            file, such as a folder, or /dev/null, which root could well replace.
    """
    folder = path.parent
    if not folder.is_dir():
        raise StreamError(f"cannot write {path}: there is no folder {folder}; create it first")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise StreamError(f"cannot write {path}: no permission to write in {folder}")
    if path.is_dir():
        raise StreamError(f"cannot write {path}: it is a folder; give the name of a file")
    if path.exists() and not path.is_file():
        raise StreamError(f"cannot write {path}: it is no ordinary file; give another name")


def check_folder(path: Path) -> None:
    """Refuse a folder of products that could not be made, before the work for it begins.

    Raises:
        StreamError: `path`, or what it would lie in, is there and no folder.
    """
    for folder in (path, *path.parents):
        if folder.exists():
            if not folder.is_dir():
                raise StreamError(f"cannot write into {path}: {folder} is no folder")
            return


def _take_place(temporary: Path, path: Path) -> None:
    try:
        synchronise(temporary, os.O_RDONLY)
        temporary.replace(path)
        synchronise(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise StreamError(f"cannot write {path}: {error.strerror}") from error


def synchronise(path: Path, flags: int) -> None:
    """Wait until the file's bytes, or the folder's names, are on the disk.

    Args:
        path: a file, or a folder.
        flags: of open(2); os.O_RDONLY, with os.O_DIRECTORY for a folder.

    Raises:
        OSError: it cannot be opened, or the disk refused.
    """
    descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
