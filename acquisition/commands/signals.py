"""What ends a command from outside."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager

_ENDS = (signal.SIGTERM, signal.SIGHUP)


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
