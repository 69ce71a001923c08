"""Rows of the filter from the samples of the sensors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapping.ego_motion.filter_types import Int64Array
from mapping.ego_motion.sample_queue import SampleQueue
from mapping.ego_motion.settings import EgoMotionSettings
from mapping.ego_motion.standstill import BoolArray, Motionless
from mapping.ego_motion.states import COLUMNS, GYRO, VIBRATION, WHEELS
from mapping.geometry import Float64Array

# A vibration that was told longer ago says nothing about now.
_VIBRATION_GAP_NS = 500_000_000
_TURN_S = 2.0

Part = tuple[Int64Array, int, Float64Array]
"""Times, kind and columns of rows of one kind."""


class RowBatch(NamedTuple):
    """Rows for the filter; the last is a tick."""

    t_ns: Int64Array
    kind: Int64Array
    values: Float64Array


def merged(parts: list[Part]) -> RowBatch:
    """Return rows in order of time and kind."""
    t_ns = np.concatenate([part[0] for part in parts])
    kind = np.concatenate([np.full(len(part[0]), part[1]) for part in parts])
    values = np.concatenate([part[2] for part in parts])
    order = np.lexsort([kind, t_ns])
    return RowBatch(t_ns[order], kind[order], values[order])


def gyro_rows(s: EgoMotionSettings, gyro: SampleQueue, after_ns: int, until_ns: int) -> Part:
    """Return the yaw rates of (after_ns, until_ns]."""
    t_ns, rate = gyro.between(after_ns, until_ns)
    values = np.zeros((len(t_ns), COLUMNS))
    values[:, 0] = rate[:, 0]
    period_s = _periods_s(gyro.t_ns, t_ns, 1e-4, s.gyro_gap_s)
    values[:, 1] = s.gyro_noise_rad_s_per_sqrt_hz**2 / (2.0 * period_s)
    # The scale's error stays the same for as long as a turn does.
    alike = np.maximum(1.0, 2.0 * _TURN_S / period_s)
    values[:, 1] += (s.gyro_scale_sigma * rate[:, 0]) ** 2 * alike
    return t_ns, GYRO, values


def wheel_rows(
    s: EgoMotionSettings, wheels: SampleQueue, after_ns: int, ticks_ns: Int64Array, stuck: BoolArray
) -> Part:
    """Return the twists from after_ns to the last tick; `stuck` (N,) belongs to the ticks."""
    t_ns, twist = wheels.between(after_ns, int(ticks_ns[-1]))
    values = np.zeros((len(t_ns), COLUMNS))
    values[:, 0], values[:, 1] = twist[:, 0], twist[:, 1] ** 2
    period_s = _periods_s(wheels.t_ns, t_ns, 1e-3, s.wheels_gap_s)
    alike = np.maximum(1.0, 2.0 * s.wheel_yaw_correlation_s / period_s)
    values[:, 2], values[:, 3] = twist[:, 2], twist[:, 3] ** 2 * alike
    tick = np.clip(np.searchsorted(ticks_ns, t_ns), 0, len(ticks_ns) - 1)
    values[:, 4] = ~stuck[tick]
    return t_ns, WHEELS, values


def speed_rows(
    s: EgoMotionSettings,
    vibration: SampleQueue,
    ticks_ns: Int64Array,
    motionless: Motionless,
    wheels_ok: BoolArray,
) -> Part:
    """Return the speeds that the vibration tells, where no wheels do."""
    by_frequency, far = vibration.at(ticks_ns)
    told = np.full(len(ticks_ns), np.nan)
    if s.vibration_m_per_cycle:
        told = np.where(far < _VIBRATION_GAP_NS, by_frequency[:, 1], np.nan)
    if s.vibration_m_s2_per_m_s:
        told = motionless.excess_m_s2 / s.vibration_m_s2_per_m_s
    chosen = np.isfinite(told) & (~wheels_ok | motionless.stuck)
    values = np.zeros((int(chosen.sum()), COLUMNS))
    values[:, 0] = told[chosen]
    values[:, 1] = s.vibration_speed_m_s**2 * 2.0 * s.vibration_speed_time_s / s.tick_s
    return ticks_ns[chosen], VIBRATION, values


def _periods_s(known_ns: Int64Array, t_ns: Int64Array, low: float, high: float) -> Float64Array:
    """Return the time since the sample before each of some samples, within limits."""
    before = np.maximum(np.searchsorted(known_ns, t_ns) - 1, 0)
    return np.clip((t_ns - known_ns[before]) * 1e-9, low, high)
