"""The threads that stamp before those that do not: real-time priority, and Python's own turns."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

# Python's own 5 ms is how long the writing thread may keep a stamping thread waiting each time;
# docs/decisions/0005-writer-thread-or-process.md has the figures.
SWITCH_INTERVAL_S = 0.0005


def raise_priority(priority: int) -> str:
    """Put the calling thread under SCHED_FIFO; return "" or why it stays as it is.

    Args:
        priority: 1 to 99, as in sched(7); 0 leaves the thread alone.
    """
    if priority == 0:
        return ""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (OSError, ValueError) as error:
        return (
            f"no real-time priority {priority} ({error}); stamps may be some ms late under load; "
            "allow it with LimitRTPRIO= in the unit file or rtprio in limits.conf"
        )
    return ""


@contextmanager
def short_switch_interval() -> Iterator[None]:
    """Let a stamping thread have the interpreter soon, however busy the writing thread is."""
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    try:
        yield
    finally:
        sys.setswitchinterval(before_s)
