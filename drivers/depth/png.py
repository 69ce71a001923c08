"""16-bit depth images in PNG files, checked by their headers and read as millimetres."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from drivers.errors import DriverError

# Pillow's names for 16-bit greyscale; a PNG opens as "I" before Pillow 11 and "I;16" since.
_GREY_16_MODES = ("I", "I;16", "I;16B")
_UINT16_MAX = 65535


@contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    """Open the header of a PNG, and turn every complaint about the file into a DriverError."""
    try:
        with path.open("rb") as file, Image.open(file, formats=("PNG",)) as image:
            yield image
    # Pillow reports damage by several classes, SyntaxError and EOFError among them.
    except (OSError, SyntaxError, ValueError, EOFError, Image.DecompressionBombError) as error:
        raise DriverError(
            f"cannot read {path}: {error}; expected a whole 16-bit greyscale PNG, restore the "
            "file or take it out of the folder and its index"
        ) from error


def check_headers(paths: Sequence[Path]) -> tuple[int, int]:
    """Read the headers of all images and return their common (width, height) in pixels.

    Raises:
        DriverError: one is missing, unreadable, not 16-bit greyscale, or of another size.
    """
    size: tuple[int, int] | None = None
    for path in paths:
        with _opened(path) as image:
            found = image.size
            if image.mode not in _GREY_16_MODES:
                raise DriverError(
                    f"{path} has mode {image.mode}; expected 16-bit greyscale depth, check that "
                    "it is no colour or preview image"
                )
        size = size or found
        _check_size(path, found, size)
    if size is None:
        raise ValueError("no images to check")
    return size


def read_counts(path: Path, size: tuple[int, int]) -> NDArray[np.uint16]:
    """Return the (height, width) counts of an image that has the given (width, height).

    Raises:
        DriverError: missing, damaged, or of another size.
    """
    with _opened(path) as image:
        _check_size(path, image.size, size)
        return np.asarray(image).astype(np.uint16)


def _check_size(path: Path, found: tuple[int, int], expected: tuple[int, int]) -> None:
    if found != expected:
        raise DriverError(
            f"{path} is {found[0]}x{found[1]} pixels; expected {expected[0]}x{expected[1]} like "
            "the first image, keep images of one size in a folder"
        )


class MillimetreTable:
    """Converts counts to millimetres: rint(counts * 1000 / scale), halves to even.

    Args:
        counts_per_m: the scale of the images, > 0; 5000 for TUM RGB-D, 1000 for millimetres.
    """

    def __init__(self, counts_per_m: float) -> None:
        self.counts_per_m = counts_per_m
        exact_mm = np.arange(_UINT16_MAX + 1) * 1000.0 / counts_per_m
        self._max_counts = int(np.searchsorted(np.rint(exact_mm), _UINT16_MAX, side="right")) - 1
        self._depth_mm = np.rint(np.minimum(exact_mm, _UINT16_MAX)).astype(np.uint16)

    def convert(self, counts: NDArray[np.uint16], path: Path) -> NDArray[np.uint16]:
        """Return read-only millimetres (mm) of the same shape; 0 stays 0, which is no return.

        Raises:
            DriverError: a depth that 16 bits of millimetres cannot hold.
        """
        highest = int(counts.max(initial=0))
        if highest > self._max_counts:
            raise DriverError(
                f"{path} has {highest} counts, {highest / self.counts_per_m:.0f} m; expected at "
                f"most {_UINT16_MAX / 1000} m, check the scale of {self.counts_per_m:g} counts per "
                "metre"
            )
        depth_mm: NDArray[np.uint16] = self._depth_mm[counts]
        depth_mm.flags.writeable = False
        return depth_mm
