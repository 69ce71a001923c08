"""Scripted drives as samples of all sensors, cheap and exactly known."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from heapq import merge

import numpy as np

from drivers.samples import AccelerationSample, Sample, WheelTwistSample, YawRateSample
from mapping.ego_motion.ego_motion import EgoMotion
from mapping.geometry import Float64Array, UncertainPose

G = 9.80665
START_NS = 1_000_000_000_000


@dataclass
class Drive:
    """Stop and go on flat ground, along an arc.
    Faults are functions that change the lists of samples.
    """

    seconds: float = 12.0
    seed: int = 1
    bias_rad_s: float = 0.01
    scale: float = 0.0
    vibration_m_s2: float = 1.0

    def speed(self, t: Float64Array) -> Float64Array:
        """Return the forward speed at times in seconds."""
        return stop_and_go(t)

    def turn(self, t: Float64Array) -> Float64Array:
        """Return the yaw rate at times in seconds."""
        return np.where(self.speed(t) > 0.0, 0.2, 0.0)

    def truth(self, t: Float64Array) -> Float64Array:
        """Return (N, 3) x, y, yaw at times in seconds."""
        fine = np.arange(0.0, self.seconds + 0.001, 0.001)
        yaw = np.cumsum(self.turn(fine)) * 0.001
        v = self.speed(fine)
        x, y = np.cumsum(v * np.cos(yaw)) * 0.001, np.cumsum(v * np.sin(yaw)) * 0.001
        return np.column_stack([np.interp(t, fine, row) for row in (x, y, yaw)])

    def acceleration(self) -> list[AccelerationSample]:
        rng = np.random.default_rng([self.seed, 0])
        t = np.arange(0.001, self.seconds, 0.001)
        v = self.speed(t)
        f = 0.02 * rng.standard_normal((len(t), 3))
        f += self.vibration_m_s2 * v[:, None] / 0.3 * rng.standard_normal((len(t), 3))
        f[:, 0] += np.gradient(v, 0.001)
        f[:, 1] += v * self.turn(t)
        f[:, 2] += G
        return [AccelerationSample(START_NS + round(1e9 * t[i]), f[i], i) for i in range(len(t))]

    def rates(self) -> list[YawRateSample]:
        rng = np.random.default_rng([self.seed, 1])
        t = np.arange(0.0025, self.seconds, 0.005)
        rate = self.turn(t) + self.bias_rad_s + 0.002 * rng.standard_normal(len(t))
        return [
            YawRateSample(START_NS + round(1e9 * t[i]), float(rate[i]), None, None, i)
            for i in range(len(t))
        ]

    def wheels(self) -> list[WheelTwistSample]:
        rng = np.random.default_rng([self.seed, 2])
        t = np.arange(0.01, self.seconds, 0.02)
        v = self.speed(t) * (1.0 + self.scale)
        v = np.where(v > 0.0, v + 0.005 * rng.standard_normal(len(t)), 0.0)
        w = np.where(v > 0.0, self.turn(t), 0.0)
        return [
            WheelTwistSample(
                START_NS + round(1e9 * t[i]), float(v[i]), float(w[i]), 0.014, 0.05, None, None, i
            )
            for i in range(len(t))
        ]

    def samples(self) -> list[Sample]:
        return in_order(self.acceleration(), self.rates(), self.wheels())


def stop_and_go(t: Float64Array) -> Float64Array:
    """Return 0.3 m/s from 2 s to 6 s and from 8 s on to 11 s, with ramps of 0.5 s."""
    share = np.interp(t, [2, 2.5, 5.5, 6, 8, 8.5, 10.5, 11], [0, 1, 1, 0, 0, 1, 1, 0])
    return np.asarray(0.3 * share, np.float64)


def in_order(*lists: Sequence[Sample]) -> list[Sample]:
    return list(merge(*lists, key=lambda sample: sample.t_ns))


def cut(samples: Sequence[Sample], start_s: float, end_s: float) -> list[Sample]:
    """Return samples without those of a span."""
    return [s for s in samples if not start_s <= (s.t_ns - START_NS) * 1e-9 < end_s]


def replay(
    ego: EgoMotion, samples: Sequence[Sample], step_s: float = 0.1
) -> Iterator[tuple[float, UncertainPose]]:
    """Add samples; yield (seconds, pose) every step_s, as soon as it is ready."""
    index = 1
    steps: list[Sample | None] = [*samples, None]
    for sample in steps:
        if sample is None:
            ego.finish()
        else:
            ego.add(sample)
        ready = ego.poses_ready_until_ns
        while ready is not None and START_NS + round(index * step_s * 1e9) <= ready:
            t_ns = START_NS + round(index * step_s * 1e9)
            pose = ego.pose_at(t_ns)
            assert pose is not None
            yield index * step_s, pose
            index += 1
