"""How many of the frames before this one were taken from the same place.

A camera that rests has the same image rows on the same ground, the same depth steps and the same
error of every pixel in all its frames: that much of their noise they share.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapping.geometry import RigidTransform, UncertainPose

# What brings other errors: an image row of a Kinect moves over the ground by its own spacing at
# 3 m, or its depth by a step. Turning about the vertical leaves the rows where they are; it takes
# more of it, so that a cell is seen by pixels whose errors are not alike.
_WAY_M = 0.025
_TILT_RAD = 0.0035
_TURN_RAD = 0.02
# Poses that are wrong anew each time seem to move by so many times the sum of their variances.
_JITTER = 9.0


class Rest(NamedTuple):
    """Where the camera first was (optical frame in T), and how many frames came after that one."""

    place: RigidTransform
    repeats: int


class Repeats:
    """Counts them, from the poses alone.

    A place is left when the camera has gone far enough from where it first was there; a way made
    of many small steps counts like one of a few large ones.

    Args:
        jittering: whether every pose is wrong anew, by its own covariance, so that a camera at
            rest seems to move; the errors of a filter's poses move with the camera instead.
        rest: as the run before has left it; None = no frame was taken yet.

    Attributes:
        rest: the place of the last frame, and how many were taken there before it.
    """

    def __init__(self, *, jittering: bool, rest: Rest | None = None) -> None:
        self._jitter = _JITTER if jittering else 0.0
        self.rest = rest

    def count(self, sensor: RigidTransform, body: UncertainPose) -> int:
        """Return how many frames before this one are alike; call it once for every frame.

        Args:
            sensor: the camera's optical frame in T.
            body: the pose that it hangs on, with its covariance.
        """
        if self.rest is None or self._has_left(self.rest.place, sensor, body):
            self.rest = Rest(sensor, 0)
        else:
            self.rest = Rest(self.rest.place, self.rest.repeats + 1)
        return self.rest.repeats

    def _has_left(self, place: RigidTransform, sensor: RigidTransform, body: UncertainPose) -> bool:
        """Compare squared motions with what leaves a place and what the pose's error feigns."""
        feigned = self._jitter * np.diag(body.covariance)
        way = sensor.translation_m - place.translation_m
        # Rows of e' C_TS: where the camera sees the vertical.
        tilt = sensor.rotation[2] - place.rotation[2]
        # 3 - trace = 2 (1 - cos angle), the square of a small angle.
        turn2 = 3.0 - float(np.vdot(place.rotation, sensor.rotation))
        return bool(
            way @ way > _WAY_M**2 + feigned[:3].sum()
            or tilt @ tilt > _TILT_RAD**2 + feigned[3:5].sum()
            or turn2 > _TURN_RAD**2 + feigned[3:].sum()
        )
