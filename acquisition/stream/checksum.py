"""The CRC-32 of MCAP (ISO 3309, as zlib's), at the speed of memory where the processor can.

zlib's own takes 0.4 ms for each megabyte that is not in the processor's cache, which on a small
computer is an eighth of what compressing it costs; ISA-L's takes a sixth of that. Where there is no
build of it, zlib gives the same numbers.
"""

from __future__ import annotations

try:
    from isal.isal_zlib import crc32
except ImportError:
    from zlib import crc32

__all__ = ["crc32"]
