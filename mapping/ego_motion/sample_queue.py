"""Samples of one sensor between their arrival and their use, put into the order of time."""

from __future__ import annotations

import numpy as np

from mapping.ego_motion.filter_types import Int64Array
from mapping.geometry import Float64Array


class SampleQueue:
    """Takes samples in whatever order, gives them in order of time.

    Args:
        width: numbers per sample.

    Attributes:
        t_ns: (N,) times of the samples that were released and not yet forgotten.
        values: (N, width) what they say.
    """

    def __init__(self, width: int) -> None:
        self._waiting: list[tuple[float, ...]] = []
        self._waiting_ns: list[int] = []
        self._released_ns = -(2**63)
        self.width = width
        self.t_ns: Int64Array = np.zeros(0, np.int64)
        self.values: Float64Array = np.zeros((0, width))

    def add(self, t_ns: int, values: tuple[float, ...]) -> bool:
        """Take a sample; False when its time has been released already."""
        if t_ns <= self._released_ns:
            return False
        self._waiting_ns.append(t_ns)
        self._waiting.append(values)
        return True

    def release(self, until_ns: int) -> None:
        """Move the samples up to a time to `t_ns` and `values`; of equal times, one stays."""
        if until_ns <= self._released_ns:
            return
        self._released_ns = until_ns
        if not self._waiting_ns:
            return
        t_ns = np.array(self._waiting_ns, np.int64)
        values = np.array(self._waiting, np.float64).reshape(-1, self.width)
        # Also by value, so that two samples of one time do not depend on who came first.
        order = np.lexsort([*values.T[::-1], t_ns])
        t_ns, values = t_ns[order], values[order]
        end = int(np.searchsorted(t_ns, until_ns, side="right"))
        fresh = np.concatenate([[True], np.diff(t_ns[:end]) > 0])[:end]
        self.t_ns = np.concatenate([self.t_ns, t_ns[:end][fresh]])
        self.values = np.concatenate([self.values, values[:end][fresh]])
        self._waiting_ns = t_ns[end:].tolist()
        self._waiting = [tuple(row) for row in values[end:].tolist()]

    def between(self, after_ns: int, until_ns: int) -> tuple[Int64Array, Float64Array]:
        """Return the released samples of (after_ns, until_ns]."""
        chosen = slice(*np.searchsorted(self.t_ns, [after_ns, until_ns], side="right"))
        return self.t_ns[chosen], self.values[chosen]

    def forget(self, before_ns: int) -> None:
        """Forget the released samples before a time, but for the last of them."""
        first = max(0, int(np.searchsorted(self.t_ns, before_ns)) - 1)
        self.t_ns, self.values = self.t_ns[first:], self.values[first:]

    def at(self, t_ns: Int64Array) -> tuple[Float64Array, Int64Array]:
        """Return (M, width) values at times, linear between samples, and distances to a sample.

        The distances (M,) are those to the nearer neighbour in ns; without any they are huge.
        """
        if not len(self.t_ns):
            return np.zeros((len(t_ns), self.width)), np.full(len(t_ns), 2**62)
        origin = self.t_ns[0]
        known, wanted = (self.t_ns - origin).astype(float), (t_ns - origin).astype(float)
        values = np.column_stack([np.interp(wanted, known, v) for v in self.values.T])
        right = np.clip(np.searchsorted(self.t_ns, t_ns), 0, len(self.t_ns) - 1)
        left = np.maximum(right - 1, 0)
        apart = np.minimum(np.abs(self.t_ns[right] - t_ns), np.abs(self.t_ns[left] - t_ns))
        return values, apart
