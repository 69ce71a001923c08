"""What is compiled beforehand: every kernel, so that its first use is not its compilation."""

from __future__ import annotations

from mapping import kernel_cache


def test_everything_is_compiled_beforehand_and_then_known_to_be() -> None:
    kernel_cache.compile_kernels()
    kernels = {kernel.py_func.__name__: kernel for kernel in kernel_cache._ENTRY_POINTS}
    assert [name for name, kernel in kernels.items() if not kernel.signatures] == []
    assert kernel_cache.kernels_are_cached()
    assert kernel_cache.filter_is_cached()
