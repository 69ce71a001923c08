"""Signals on the filter's grid of time: one block of samples around every tick."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from mapping.ego_motion.filter_types import Int64Array
from mapping.geometry import Float64Array


@dataclass(frozen=True, slots=True)
class Blocks:
    """What was measured around N ticks.

    Attributes:
        t_ns: (N,) the ticks.
        force_m_s2: (N, 3) mean specific force in base_link's axes; 0 where there is none.
        count: (N,) samples of it; those of a shock are not counted.
        scatter_m2_s4: (N,) variance of the force within the block, summed over the axes.
        shock: (N,) whether one of the samples was a shock.
        speed_m_s, wheels_ok: (N,) of the wheels, and whether they report.
        wheel_turn_rad_s, wheel_turn_sigma_rad_s: (N,) of the wheels.
        turn_rad_s, gyro_ok: (N,) of the gyro, bias included, and whether it reports.
        vibration_m_s2: (N,) RMS that a vibration sensor tells, summed over the axes; NaN where
            it tells none.
    """

    t_ns: Int64Array
    force_m_s2: Float64Array
    count: Int64Array
    scatter_m2_s4: Float64Array
    shock: np.ndarray[tuple[int], np.dtype[np.bool_]]
    speed_m_s: Float64Array
    wheels_ok: np.ndarray[tuple[int], np.dtype[np.bool_]]
    wheel_turn_rad_s: Float64Array
    wheel_turn_sigma_rad_s: Float64Array
    turn_rad_s: Float64Array
    gyro_ok: np.ndarray[tuple[int], np.dtype[np.bool_]]
    vibration_m_s2: Float64Array

    def __len__(self) -> int:
        return len(self.t_ns)

    def joined(self, other: Blocks) -> Blocks:
        """Return these blocks with others behind them."""
        return Blocks(
            *(
                np.concatenate([getattr(self, item.name), getattr(other, item.name)])
                for item in fields(self)
            )
        )

    def last(self, count: int) -> Blocks:
        """Return the last blocks."""
        first = max(0, len(self) - count)
        return Blocks(*(getattr(self, item.name)[first:] for item in fields(self)))


def force_blocks(
    t_ns: Int64Array,
    force_m_s2: Float64Array,
    ticks_ns: Int64Array,
    tick_ns: int,
    shock_m_s2: float,
) -> tuple[Float64Array, Int64Array, Float64Array, np.ndarray[tuple[int], np.dtype[np.bool_]]]:
    """Return mean (N, 3), count, scatter and shock of accelerations around ticks.

    Args:
        t_ns: (M,) times of the accelerations.
        force_m_s2: (M, 3) what they are.
        ticks_ns: (N,) the ticks; a block reaches half a tick to either side.
        tick_ns: their distance.
        shock_m_s2: beyond it an acceleration is a shock.
    """
    size = len(ticks_ns)
    which = (t_ns - (ticks_ns[0] - tick_ns // 2)) // tick_ns
    inside = (which >= 0) & (which < size)
    violent = inside & ((force_m_s2**2).sum(axis=1) > shock_m_s2**2)
    shock = np.bincount(which[violent], minlength=size) > 0
    inside &= ~violent
    which, force = which[inside], force_m_s2[inside]
    count = np.bincount(which, minlength=size)
    some = np.maximum(count, 1)
    mean = np.column_stack([np.bincount(which, axis, size) / some for axis in force.T])
    square = ((force - mean[which]) ** 2).sum(axis=1)
    return mean, count, np.bincount(which, square, size) / some, shock
