"""What went wrong on the way, as something a program can act on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

EventKind = Literal[
    "gyro_lost",
    "gyro_back",
    "wheels_lost",
    "wheels_back",
    "wheels_stuck",
    "wheels_slip",
    "acceleration_lost",
    "acceleration_back",
    "shock",
    "late_sample",
    "bad_sample",
    "pose_rejected",
    "clock_jump",
]


@dataclass(frozen=True, slots=True)
class EgoEvent:
    """Something that the pose suffered from.

    Attributes:
        t_ns: sensor time at which it was noticed.
        kind: what it was.
        text: one line for people.
    """

    t_ns: int
    kind: EventKind
    text: str
