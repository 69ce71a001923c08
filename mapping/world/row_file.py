"""A table on disk to which rows are only ever added, and whose length somebody else keeps.

Rows behind those that count belong to a save that was not finished; the next one replaces them.
"""

from __future__ import annotations

import os
import zlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[Any]


class RowCount(NamedTuple):
    """How many rows count, and the CRC-32 of their bytes."""

    rows: int
    crc32: int


class RowFile:
    """Reads and appends.

    Args:
        path: the file.
        dtype: of each number, in little-endian.
        columns: numbers in a row.

    Attributes:
        count: the rows that count, which `read` and `settle` set.
    """

    def __init__(self, path: Path, dtype: str, columns: int) -> None:
        self._path = path
        self._dtype = np.dtype(dtype)
        self._columns = columns
        self.count = RowCount(0, 0)

    def read(self, count: RowCount) -> Rows:
        """Return the rows that count, (rows, columns), read-only.

        Raises:
            OSError, ValueError: they cannot be read, or are not those that were written.
        """
        content = self._path.read_bytes()[: count.rows * self._row_bytes]
        if zlib.crc32(content) != count.crc32:
            raise ValueError(f"{self._path.name} does not have the {count.rows} rows of the run")
        self.count = count
        return np.frombuffer(content, self._dtype).reshape(count.rows, self._columns)

    def append(self, rows: Rows) -> RowCount:
        """Put rows behind those that count, see them onto the disk; return what is to be settled.

        Raises:
            OSError: the disk refuses; the rows that count stay as they were.
        """
        content = np.ascontiguousarray(rows, self._dtype).tobytes()
        with self._path.open("ab") as file:
            file.truncate(self.count.rows * self._row_bytes)
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        return RowCount(self.count.rows + len(rows), zlib.crc32(content, self.count.crc32))

    @property
    def _row_bytes(self) -> int:
        return self._columns * self._dtype.itemsize
