"""What a run knows beside its cells: what reading them out takes, and what going on takes."""

from __future__ import annotations

from dataclasses import dataclass

from mapping.geometry import UncertainPose
from mapping.motion.known_frames import Keys
from mapping.motion.read_out import Rover, standing
from mapping.motion.repeats import Rest


@dataclass(frozen=True, slots=True)
class RunState:
    """A run after one of its frames.

    Attributes:
        rover: where it is, the motions that the cells' stamps refer to, and what its poses are
            worth now.
        pose: T_TB of its last frame or motion; None before the first.
        told: T_TB at the end of the last motion that was told; None where none ever is.
        slid_rad: by how much the map was found to have slid against gravity.
        rest: where the camera was at its last frame, and since how many; None before the first.
        frames: keys of the depth frames that were dealt with; None where nobody keeps them.
    """

    rover: Rover
    pose: UncertainPose | None
    told: UncertainPose | None
    slid_rad: float
    rest: Rest | None = None
    frames: Keys | None = None


def fresh_run() -> RunState:
    """Return the state of a run that has seen nothing."""
    return RunState(standing(), None, None, 0.0)
