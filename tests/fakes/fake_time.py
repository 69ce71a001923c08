"""A clock that moves only when somebody sleeps on it or pushes it."""

from __future__ import annotations


class FakeTime:
    """Call it for nanoseconds; `sleep` and `advance` move it.

    Attributes:
        now_ns: what it shows.
        slept_s: how long each sleep was.
    """

    def __init__(self, start_ns: int = 1_000_000_000) -> None:
        self.now_ns = start_ns
        self.slept_s: list[float] = []

    def __call__(self) -> int:
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        assert seconds >= 0.0, f"slept {seconds} s"
        self.slept_s.append(seconds)
        self.now_ns += max(1, round(seconds * 1e9))

    def advance(self, seconds: float) -> None:
        self.now_ns += round(seconds * 1e9)
