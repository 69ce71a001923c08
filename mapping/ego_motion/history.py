"""The states at the last ticks, in one piece of memory that never grows."""

from __future__ import annotations

import numpy as np

from mapping.ego_motion.filter_types import States
from mapping.ego_motion.states import COLUMNS, SIZE
from mapping.geometry import Float64Array


def empty_states(count: int) -> States:
    """Return room for that many states."""
    return States(
        np.zeros(count, np.int64),
        np.zeros((count, SIZE)),
        np.zeros((count, SIZE, SIZE)),
        np.zeros((count, SIZE, SIZE)),
        np.zeros((count, COLUMNS)),
    )


def part_of(states: States, chosen: slice) -> States:
    """Return a view of some of the states."""
    return States(
        states.t_ns[chosen],
        states.x[chosen],
        states.p[chosen],
        states.phi[chosen],
        states.held[chosen],
    )


def copied(state: States) -> States:
    """Return a copy whose phi starts anew."""
    phi = np.broadcast_to(np.eye(SIZE), state.phi.shape).copy()
    return States(state.t_ns.copy(), state.x.copy(), state.p.copy(), phi, state.held.copy())


class History:
    """States in order of time; the oldest are forgotten.

    Args:
        length: how many states are kept at least.
    """

    def __init__(self, length: int) -> None:
        self._length = length
        self._room = empty_states(4 * length)
        self._first = self._end = 0

    def __len__(self) -> int:
        return self._end - self._first

    @property
    def oldest_ns(self) -> int:
        """Time of the oldest state."""
        return int(self._room.t_ns[self._first])

    @property
    def newest_ns(self) -> int:
        """Time of the newest state."""
        return int(self._room.t_ns[self._end - 1])

    def room_for(self, count: int) -> States:
        """Return room for further states; `add` makes them part of the history."""
        if self._end + count > len(self._room.t_ns):
            self._forget(count)
        return part_of(self._room, slice(self._end, self._end + count))

    def add(self, count: int) -> None:
        """Take what was written to the beginning of the room that was given last."""
        self._end += count

    def cut_behind(self, index: int) -> None:
        """Forget the states behind one, to be found again."""
        self._end = self._first + index + 1

    def index_at(self, t_ns: int) -> int:
        """Return the index of the last state at or before a time; -1 before all of them."""
        kept = self._room.t_ns[self._first : self._end]
        return int(np.searchsorted(kept, t_ns, side="right")) - 1

    def state(self, index: int) -> States:
        """Return a copy of one state; its phi starts anew."""
        at = self._first + index
        return copied(part_of(self._room, slice(at, at + 1)))

    def phi_since(self, index: int, last: int) -> Float64Array:
        """Return the derivative of the error at state `last` by that at state `index`."""
        product = np.eye(SIZE)
        for at in range(self._first + index + 1, self._first + last + 1):
            product = self._room.phi[at] @ product
        return product

    def _forget(self, count: int) -> None:
        """Move the states to keep to the front of a room that is large enough."""
        keep = min(len(self), self._length)
        start = self._end - keep
        room = self._room
        if keep + count > len(room.t_ns):
            room = empty_states(2 * (keep + count))
        for new, old in zip(room, self._room, strict=True):
            new[:keep] = old[start : self._end].copy()
        self._room, self._first, self._end = room, 0, keep
