"""Made-up motions with known signals."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulation.motion import Motion

START_NS = 1_000_000_000_000


def motion(
    seconds: float,
    *,
    position_m: ArrayLike = (0.0, 0.0, 0.0),
    body_rate_rad_s: ArrayLike = (0.0, 0.0, 0.0),
    acceleration_m_s2: ArrayLike = (0.0, 0.0, 9.80665),
    wheel_rate_rad_s: ArrayLike = (0.0, 0.0, 0.0, 0.0),
    command: ArrayLike = (0.0, 0.0),
) -> Motion:
    """Level, without turning in its poses; signals are constant, or have a row per millisecond."""
    count = round(seconds * 1000) + 1

    def rows(values: ArrayLike, width: int) -> NDArray[np.float64]:
        return np.array(np.broadcast_to(np.asarray(values, float), (count, width)))

    return Motion(
        START_NS,
        rows(position_m, 3),
        rows((1.0, 0.0, 0.0, 0.0), 4),
        rows((0.0, 0.0, 0.0), 3),
        rows(body_rate_rad_s, 3),
        rows(acceleration_m_s2, 3),
        rows(wheel_rate_rad_s, 4),
        rows(command, 2),
    )
