"""RVL, the lossless code for depth images that ROS's compressedDepth transport can use.

A. D. Wilson, "Fast lossless depth image compression", ACM ISS 2017. The pixels, row by row, are
runs of zeros and of others in turn: the length of the run of zeros, the length of the run of
others, and for each of these the difference to the one before it (of the first, to 0), folded to a
number without sign: 0, -1, 1, -2, ... become 0, 1, 2, 3, ... Each number is written in groups of
three bits, the lowest first, each with a fourth bit that says whether another one follows. Eight
of these nibbles, the first on top, are a little-endian word of 32 bits; the last one is filled up.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

# Bytes for each pixel at most: a difference of 17 bits is six nibbles, and where runs are one
# pixel long their lengths take the place of a pixel that needs none.
MOST_BYTES_PER_PIXEL = 3
_MOST_NIBBLES = 10  # of one number: 30 bits


@njit(cache=True, nogil=True)
def _put(out: NDArray[np.uint8], at: int, value: int | np.int64) -> int:
    """Write a number as nibbles from nibble `at` on; return where the next one goes."""
    while True:
        nibble = value & 7
        value >>= 3
        if value:
            nibble |= 8
        place = at % 8
        out[at // 8 * 4 + 3 - place // 2] |= nibble << (0 if place % 2 else 4)
        at += 1
        if not value:
            return at


@njit(cache=True, nogil=True)
def pack(pixels: NDArray[np.uint16], out: NDArray[np.uint8]) -> int:
    """Write pixels (N,) into zeroed bytes, `MOST_BYTES_PER_PIXEL` N + 8; return how many."""
    at = 0
    start = 0
    previous = np.int64(0)
    while start < pixels.size:
        begin = start
        while begin < pixels.size and pixels[begin] == 0:
            begin += 1
        end = begin
        while end < pixels.size and pixels[end] != 0:
            end += 1
        at = _put(out, at, begin - start)
        at = _put(out, at, end - begin)
        for i in range(begin, end):
            difference = np.int64(pixels[i]) - previous
            previous = np.int64(pixels[i])
            at = _put(out, at, 2 * difference if difference >= 0 else -2 * difference - 1)
        start = end
    return (at + 7) // 8 * 4


@njit(cache=True, nogil=True)
def _get(data: NDArray[np.uint8], at: int) -> tuple[np.int64, int]:
    """Return the number at nibble `at` and where the next one is; -1 where there is none."""
    value = np.int64(0)
    for group in range(_MOST_NIBBLES):
        if at >= 2 * data.size:
            return np.int64(-1), at
        place = at % 8
        byte = np.int64(data[at // 8 * 4 + 3 - place // 2])
        nibble = byte & 15 if place % 2 else byte >> 4
        at += 1
        value |= (nibble & 7) << (3 * group)
        if nibble < 8:
            return value, at
    return np.int64(-1), at


@njit(cache=True, nogil=True)
def unpack(data: NDArray[np.uint8], count: int, out: NDArray[np.uint16]) -> bool:
    """Tell whether whole words hold exactly so many pixels; put them into `out` if it has room.

    An empty `out` asks without any memory for the answer, which nonsense may claim to be large.
    """
    at = 0
    done = np.int64(0)
    previous = np.int64(0)
    wanted = out.size > 0
    while done < count:
        zeros, at = _get(data, at)
        others, at = _get(data, at)
        if zeros < 0 or others < 0 or zeros + others == 0 or done + zeros + others > count:
            return False
        done += zeros
        for _ in range(others):
            folded, at = _get(data, at)
            previous += -(folded >> 1) - 1 if folded & 1 else folded >> 1
            if folded < 0 or not 0 < previous < 65536:
                return False
            if wanted:
                out[done] = previous
            done += 1
    return bool((at + 7) // 8 * 4 == data.size)
