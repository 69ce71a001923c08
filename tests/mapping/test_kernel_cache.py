"""What is compiled beforehand: every kernel, so that its first use is not its compilation."""

from __future__ import annotations

import zlib
from pathlib import Path

from mapping import kernel_cache
from mapping.ego_motion import filter_kernels, filter_motion, filter_types, filter_updates, states


def test_everything_is_compiled_beforehand_and_then_known_to_be() -> None:
    kernel_cache.compile_kernels()
    kernels = {kernel.py_func.__name__: kernel for kernel in kernel_cache._ENTRY_POINTS}
    assert [name for name, kernel in kernels.items() if not kernel.signatures] == []
    assert kernel_cache.kernels_are_cached()
    assert kernel_cache.filter_is_cached()


def test_the_filter_is_compiled_anew_when_its_parts_change() -> None:
    parts = (filter_motion, filter_types, filter_updates, states)
    content = b"".join(Path(str(part.__file__)).read_bytes() for part in parts)
    assert zlib.crc32(content) == filter_kernels.PARTS_CRC32, (
        f"the filter's parts have changed: let PARTS_CRC32 be 0x{zlib.crc32(content):08X}"
    )
