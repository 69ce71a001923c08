"""Messages of several devices into one order, by the stream's own time."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from itertools import count
from typing import Generic, TypeVar

_T = TypeVar("_T")


class ReorderBuffer(Generic[_T]):
    """Holds messages until nothing older is expected.

    A message leaves when the highest log time seen is `window_ns` or more ahead of it. The order
    is by log time, then by the order of arrival. One that is older than a message that has left
    already is late: it cannot be put into order any more. All of this depends only on the
    sequence of messages, never on when they are pushed.
    """

    def __init__(self, window_ns: int) -> None:
        self._window_ns = window_ns
        self._heap: list[tuple[int, int, _T]] = []
        self._arrivals = count()
        self._highest_ns = 0
        self._left_ns = 0

    def push(self, log_time_ns: int, message: _T) -> bool:
        """Take a message; false when it is late, and then it is not kept."""
        if log_time_ns < self._left_ns:
            return False
        self._highest_ns = max(self._highest_ns, log_time_ns)
        heapq.heappush(self._heap, (log_time_ns, next(self._arrivals), message))
        return True

    def ready(self) -> Iterator[_T]:
        """Give the messages that leave now, in order."""
        while self._heap and self._heap[0][0] + self._window_ns <= self._highest_ns:
            yield self._pop()

    def rest(self) -> Iterator[_T]:
        """Give all that is left, in order: nothing more will come."""
        while self._heap:
            yield self._pop()

    def _pop(self) -> _T:
        self._left_ns, _, message = heapq.heappop(self._heap)
        return message
