"""Does the map still stand upright? Aligned tilt against levelled tilt, over seconds.

Alignment holds a frame against the map, and the map against earlier frames: together they can
slide. Levelling is poor at every moment but does not drift. The mean of n seconds of their
difference has the standard deviation sigma_lev sqrt(2 tau / n); three of it are too much.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapping.errors import MappingError

Float64Array = NDArray[np.float64]

_SIGMAS = 3.0


@dataclass(frozen=True, slots=True)
class GravitySettings:
    """Settings of the check.

    Attributes:
        window_s: length of the mean.
        levelling_sigma_rad: standard deviation of a levelled tilt, in each of roll and pitch.
        levelling_time_s: time over which its errors are alike.
    """

    window_s: float = 5.0
    levelling_sigma_rad: float = math.radians(2.0)
    levelling_time_s: float = 0.3

    def __post_init__(self) -> None:
        """Refuse values that check nothing."""
        for name in self.__dataclass_fields__:
            if not 0.0 < getattr(self, name) < math.inf:
                raise MappingError(f"{name} is {getattr(self, name)}; expected a number above 0")

    @property
    def limit_rad(self) -> float:
        """Largest mean difference that levelling explains."""
        share = 2.0 * self.levelling_time_s / self.window_s
        return _SIGMAS * self.levelling_sigma_rad * math.sqrt(share)


class GravityCheck:
    """The mean of the last seconds; one value for every aligned frame."""

    def __init__(self, settings: GravitySettings) -> None:
        self.settings = settings
        self._window_ns = round(settings.window_s * 1e9)
        self._differences: deque[tuple[int, Float64Array]] = deque()

    def add(self, t_ns: int, up_body: Float64Array, rotation: Float64Array) -> float:
        """Take a frame; return by how much the map has slid, 0 while levelling explains it.

        Args:
            t_ns: time of the frame; not before the last.
            up_body: (3,) unit vector against gravity as levelled, in the body's axes.
            rotation: (3, 3) aligned C_TB.

        Returns:
            Angle in radians between gravity and the map's idea of it; 0 before the window is full.
        """
        up = rotation @ up_body
        self._differences.append((t_ns, np.array([-up[1], up[0]])))
        while t_ns - self._differences[0][0] > self._window_ns:
            self._differences.popleft()
        # One frame's period short of a window is full.
        if t_ns - self._differences[0][0] < 0.9 * self._window_ns:
            return 0.0
        mean = np.mean([tilt for _, tilt in self._differences], axis=0)
        angle = math.hypot(float(mean[0]), float(mean[1]))
        return angle if angle > self.settings.limit_rad else 0.0
