"""The faults that act on the vehicle itself, millisecond by millisecond."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from simulation.faults import Fault, Shock, Slip, SpinningWheels
from simulation.vehicle.jackal import WHEEL_RADIUS_M
from simulation.vehicle.vehicle import Disturbance, Vehicle

Float64Array = NDArray[np.float64]

# A hung-up vehicle is held horizontally by a spring and damper, N/m and N s/m: critically damped.
_HOLD_N_M = 5000.0
_HOLD_NS_M = 600.0
_HUNG_UP_GRIP = 0.1

_FREE = Disturbance()


class FaultForces:
    """Turns faults into disturbances of one vehicle.

    Args:
        faults: those of devices are passed over.
        vehicle: the one that they act on.
    """

    def __init__(self, faults: Sequence[Fault], vehicle: Vehicle) -> None:
        self._faults = [f for f in faults if isinstance(f, Slip | SpinningWheels | Shock)]
        self._vehicle = vehicle
        self._held_at: dict[int, Float64Array] = {}

    def at(self, t_s: float, commanded_rad_s: Float64Array) -> tuple[Float64Array, Disturbance]:
        """Return the (4,) wheel rates to command instead, and what acts on the vehicle."""
        active = [i for i, fault in enumerate(self._faults) if fault.holds(t_s)]
        if not active:
            return commanded_rad_s, _FREE
        grip, force_n = np.ones(4), np.zeros(3)
        for i in active:
            fault = self._faults[i]
            if isinstance(fault, Slip):
                grip[list(fault.wheels)] *= fault.grip
            elif isinstance(fault, Shock):
                force_n += self._knock(fault, t_s)
            else:
                commanded_rad_s = np.full(4, fault.speed_m_s / WHEEL_RADIUS_M)
                grip *= _HUNG_UP_GRIP
                force_n += self._hold(i)
        return commanded_rad_s, Disturbance(grip, force_n)

    def _knock(self, fault: Shock, t_s: float) -> Float64Array:
        """F = m dv pi / (2 T) sin(pi t / T), whose integral over T is m dv; mid-millisecond."""
        phase = math.pi * (t_s + 0.0005 - fault.start_s) / fault.duration_s
        peak = self._vehicle.mass_kg * math.pi / (2.0 * fault.duration_s)
        return peak * max(0.0, math.sin(phase)) * np.array(fault.velocity_change_m_s)

    def _hold(self, i: int) -> Float64Array:
        position = self._vehicle.position_m
        anchor = self._held_at.setdefault(i, position)
        force = _HOLD_N_M * (anchor - position) - _HOLD_NS_M * self._vehicle.velocity_m_s
        force[2] = 0.0
        return np.asarray(force, np.float64)
