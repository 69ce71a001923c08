"""A clock that moves only when somebody sleeps on it or pushes it."""

from __future__ import annotations


class FakeTime:
    """Call it for nanoseconds; `sleep` and `advance` move it."""

    def __init__(self, start_ns: int = 1_000_000_000) -> None:
        self.now_ns = start_ns

    def __call__(self) -> int:
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        assert seconds >= 0.0, f"slept {seconds} s"
        self.now_ns += max(1, round(seconds * 1e9))

    def advance(self, seconds: float) -> None:
        self.now_ns += round(seconds * 1e9)
