"""The paper's ego-motion behind the same interface as the filter's, to be seen beside it."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence

import numpy as np

from acquisition.messages.codec import Recordable
from drivers.samples import AccelerationSample, YawRateSample
from mapping.ego_motion.events import EgoEvent
from mapping.ego_motion.paper2019 import PaperState, paper_start, paper_step
from mapping.ego_motion.settings import EgoMotionSettings
from mapping.ego_motion.tilt import rotation
from mapping.geometry import Float64Array, RigidTransform, UncertainPose

# Gravity and the accelerometer's bias are the mean of the first second, the body upright.
_LEARN_NS = 1_000_000_000


class PaperMotion:
    """Equations 36-55 of 2019 on accelerations and a yaw rate in order of time.

    Args:
        settings: of them, the gyro's noise is used.
        acceleration_density: white noise of the accelerometer, m/s^2/rtHz.
        beta_is_rate: see `paper2019`.
    """

    def __init__(
        self,
        settings: EgoMotionSettings,
        *,
        acceleration_density: float = 0.05,
        beta_is_rate: bool = False,
    ) -> None:
        self._rate_density = settings.gyro_noise_rad_s_per_sqrt_hz
        self._acceleration_density = acceleration_density
        self._beta_is_rate = beta_is_rate
        self._first: list[Float64Array] = []
        self._begin_ns: int | None = None
        self._gravity = np.zeros(3)
        self._rates: list[float] = []
        self._last_rate: float | None = None
        self._last_ns = 0
        self._state: PaperState = paper_start()
        self._t_ns: list[int] = []
        self._poses: list[UncertainPose] = []

    @property
    def events(self) -> Sequence[EgoEvent]:
        """Return nothing: the paper notices nothing."""
        return ()

    @property
    def poses_ready_until_ns(self) -> int | None:
        """The last time for which `pose_at` has an answer."""
        return self._t_ns[-1] if self._t_ns else None

    def add(self, sample: Recordable) -> None:
        """Take the next sample; others than accelerations and yaw rates say nothing."""
        if isinstance(sample, YawRateSample):
            self._rates.append(sample.rate_rad_s)
        elif isinstance(sample, AccelerationSample):
            self._add_acceleration(sample.t_ns, sample.acceleration_m_s2)

    def finish(self) -> None:
        """Do nothing: nothing waits."""

    def pose_at(self, t_ns: int) -> UncertainPose | None:
        """Return the pose of the last sample at or before a time; None outside of the drive."""
        if not self._t_ns or not self._t_ns[0] <= t_ns <= self._t_ns[-1]:
            return None
        found = self._poses[bisect_right(self._t_ns, t_ns) - 1]
        return UncertainPose(t_ns, found.transform, found.covariance)

    def _add_acceleration(self, t_ns: int, force: Float64Array) -> None:
        if self._begin_ns is None:
            self._begin_ns = t_ns
        if t_ns - self._begin_ns < _LEARN_NS:
            self._first.append(force)
        elif t_ns > self._last_ns and self._last_ns and self._first:
            self._gravity = np.mean(self._first, axis=0)
            self._step(t_ns, force - self._gravity, (t_ns - self._last_ns) * 1e-9)
        self._last_ns = max(t_ns, self._last_ns)

    def _step(self, t_ns: int, acceleration: Float64Array, dt_s: float) -> None:
        rate = float(np.mean(self._rates)) if self._rates else self._last_rate
        self._rates.clear()
        beta = 0.0
        if rate is not None and self._last_rate is not None:
            beta = rate if self._beta_is_rate else (rate - self._last_rate) / dt_s
        self._last_rate = rate
        per_s = 1.0 / (2.0 * dt_s)
        gyro = self._rate_density**2 * per_s * (1.0 if self._beta_is_rate else 2.0 / dt_s**2)
        noise = np.diag([self._acceleration_density**2 * per_s] * 3 + [gyro])
        self._state = paper_step(self._state, acceleration, beta, dt_s, noise).state
        self._t_ns.append(t_ns)
        self._poses.append(_upright(t_ns, self._state))


def _upright(t_ns: int, state: PaperState) -> UncertainPose:
    """Return the pose of the upright body; roll and pitch are 0 with no error, as in eq. 35."""
    covariance = np.zeros((6, 6))
    kept = np.ix_([0, 1, 2, 5], [0, 1, 2, 5])
    covariance[kept] = state.covariance
    yaw = math.remainder(state.yaw_rad, 2.0 * math.pi)
    return UncertainPose(
        t_ns, RigidTransform(rotation(0.0, 0.0, yaw), state.position_m), covariance
    )
