"""NetCDF-4 files with a seal: damage is found before the HDF5 library meets it.

The file is an ordinary NetCDF-4 file followed by 82 bytes that every reader skips: a mark and
the SHA-256 of all that stands before it. HDF5 does not survive every damaged file (some make it
loop for ever), so a sealed file is checked first. A file that another program has rewritten has
no seal any more; it is read all the same, and whether its arrays are right is for the caller.
"""

from __future__ import annotations

import hashlib
import io
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import xarray as xr

from mapping.errors import MappingError
from mapping.files import read_whole, write_whole

CONVENTIONS = "CF-1.11"
FRAME = "terrain frame, z up, ENU-free local"

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_MARK = b"\nterravibe-sha256:"
_SEAL_LENGTH = len(_MARK) + 64
# What xarray, h5netcdf and h5py are known to raise on files that are damaged or of another kind.
_UNREADABLE = (OSError, ValueError, KeyError, RuntimeError, TypeError, AttributeError)


def software() -> str:
    """Return name and version of this software, for the files that it writes."""
    try:
        return f"terravibe {version('terravibe')}"
    except PackageNotFoundError:
        return "terravibe (run from source, not installed)"


def write_netcdf(dataset: xr.Dataset, path: Path) -> None:
    """Write a dataset, compressed and without fill values; equal datasets give equal bytes.

    Raises:
        MappingError: an attribute cannot be stored, or the file cannot be written.
    """
    encoding = {
        name: {"zlib": True, "complevel": 4, "_FillValue": None} for name in dataset.data_vars
    }
    encoding |= {name: {"_FillValue": None} for name in dataset.coords}
    buffer = io.BytesIO()
    try:
        dataset.to_netcdf(buffer, engine="h5netcdf", encoding=encoding)
    except (ValueError, TypeError, OverflowError) as error:
        reason = str(error).splitlines()[0]
        raise MappingError(
            f"cannot write {path}: {reason}; attributes must be plain text or 64-bit numbers"
        ) from error
    content = buffer.getvalue()
    write_whole(path, content + _seal(content))


def what_lacks(error: Exception) -> str:
    """Return the first sentence of an error of xarray's, which goes on to list what there is."""
    return str(error).strip('"').splitlines()[0].partition(". ")[0]


def read_netcdf(path: Path) -> xr.Dataset:
    """Return a file's arrays and attributes as they are stored, in memory.

    Raises:
        MappingError: the file cannot be read, is no NetCDF-4 file, or is damaged.
    """
    content = read_whole(path)
    if not content.startswith(_SIGNATURE):
        raise MappingError(f"{path} is not a NetCDF-4 file; give a file that terravibe has written")
    body, seal = content[:-_SEAL_LENGTH], content[-_SEAL_LENGTH:]
    if seal.startswith(_MARK) and seal != _seal(body):
        raise damaged(path)
    try:
        with xr.open_dataset(io.BytesIO(content), engine="h5netcdf", decode_cf=False) as dataset:
            return dataset.load()
    except _UNREADABLE as error:
        raise damaged(path) from error


def damaged(path: Path) -> MappingError:
    """Return the error of a file whose content is not what was written."""
    return MappingError(
        f"{path} is damaged: its content does not match its checksum, or its end is missing; "
        "take it from a backup or make it again"
    )


def _seal(content: bytes) -> bytes:
    return _MARK + hashlib.sha256(content).hexdigest().encode()
