"""Real-time priority for the threads that stamp, where the system permits it."""

from __future__ import annotations

import os


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
