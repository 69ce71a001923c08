"""What ends a command from outside."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_ENDS = (signal.SIGTERM, signal.SIGHUP)
_STOPS = (signal.SIGINT, *_ENDS)


@contextmanager
def ended_like_interrupted() -> Iterator[None]:
    """Let SIGTERM, and SIGHUP as of a lost connection, raise KeyboardInterrupt as Ctrl-C does.

    Otherwise they would end the program at once, and leave what is half-written of a product
    under its hidden name, where it takes room that nobody sees. What is ignored stays so (nohup),
    and a command may take the signals for itself.
    """
    taken = [number for number in _ENDS if signal.getsignal(number) is signal.SIG_DFL]
    for number in taken:
        signal.signal(number, signal.default_int_handler)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)


class Stop:
    """Whether to stop recording: asked for, or the time is up.

    A plain flag and no `Event`, whose lock a second signal would wait for within the first one's
    handler, for ever.
    """

    def __init__(self) -> None:
        self._is_set = False
        self._end_s: float | None = None

    def set(self) -> None:
        """Stop now."""
        self._is_set = True

    def after(self, seconds: float) -> None:
        """Stop so long from now."""
        self._end_s = time.monotonic() + seconds

    def is_set(self) -> bool:
        """Tell whether to stop."""
        return self._is_set or (self._end_s is not None and time.monotonic() >= self._end_s)


@contextmanager
def stopped_by_signals(trigger: Callable[[], object]) -> Iterator[Stop]:
    """Give a stop that SIGINT, SIGTERM and SIGHUP set; SIGUSR1 calls `trigger`.

    What is ignored stays so: `nohup terravibe record` goes on when its terminal is closed.
    """
    stop = Stop()
    taken = [number for number in _STOPS if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, lambda *_: stop.set()) for number in taken}
    before[signal.SIGUSR1] = signal.signal(signal.SIGUSR1, lambda *_: trigger())
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
