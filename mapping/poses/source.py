"""What the mapper needs of a source of poses, and the one that the settings ask for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from acquisition.messages.codec import Recordable
from mapping.alignment.scan_to_map import Alignment
from mapping.geometry import UncertainPose

Float64Array = NDArray[np.float64]


@dataclass(slots=True)
class PoseCounts:
    """What became of a source's input.

    Attributes:
        poses: recorded poses taken.
        out_of_order: recorded poses left out because they came out of order.
        events: things that estimated poses suffered from.
    """

    poses: int = 0
    out_of_order: int = 0
    events: int = 0


class PoseSource(Protocol):
    """Gives the pose of one body at any time that lies far enough behind the stream's."""

    @property
    def body_frame(self) -> str:
        """Name of the frame whose poses these are."""

    @property
    def hears_map(self) -> bool:
        """Whether `correct` changes the poses to come."""

    @property
    def counts(self) -> PoseCounts:
        """What became of the input so far."""

    def add(self, sample: Recordable) -> None:
        """Take the next sample of the stream, of whatever type."""

    def finish(self) -> None:
        """Take note that the stream is over: whatever can be known is ready now."""

    def is_ready(self, t_ns: int) -> bool:
        """Tell whether later samples can no longer change the pose at that time."""

    def at(self, t_ns: int) -> UncertainPose | None:
        """Return the pose at a time; None where there is none. Ask in order of time.

        Raises:
            MappingError: the stream lacks what the source lives on; says what.
        """

    @property
    def latest(self) -> UncertainPose | None:
        """The last pose that is final, of a source whose errors grow with motion; else None."""

    def motion_covariance(self, before: UncertainPose, after: UncertainPose) -> Float64Array:
        """Return (4, 4) of the error of (x, y, z, yaw) of the motion between two poses.

        In axes of T: m^2, m rad, rad^2; zeros where the source does not tell.
        """

    def correct(self, alignment: Alignment) -> None:
        """Take what the map says of a pose that `at` gave."""

    def why_nothing(self, frames: int) -> str:
        """Say, as a message for people, why none of so many depth frames has a pose."""
