"""The direction of gravity as the accelerometer feels it, averaged between depth frames."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from acquisition.messages.codec import Recordable
from acquisition.messages.frames import ACCELEROMETER_FRAME, BASE_FRAME, VIBRATION_FRAME
from drivers.samples import AccelerationSample, VibrationSample
from mapping.mounts import MountTree

Float64Array = NDArray[np.float64]

# Accelerations older than this against the newest are forgotten: no depth frame is so late.
_HISTORY_NS = 10_000_000_000


class FeltGravity:
    """Collects accelerations.

    Args:
        mounts: filled by somebody else while the stream goes on.
        body_frame: in whose axes gravity is wanted. A sensor without a mount has base_link's axes,
            as in ego-motion, and says nothing of another body.
    """

    def __init__(self, mounts: MountTree, body_frame: str) -> None:
        self._mounts = mounts
        self._body_frame = body_frame
        self._forces: deque[tuple[int, str, Float64Array]] = deque()
        self._axes: dict[str, Float64Array] = {}

    def add(self, sample: Recordable) -> None:
        """Take an acceleration; every other sample says nothing."""
        if isinstance(sample, AccelerationSample):
            self._append(sample.t_ns, ACCELEROMETER_FRAME, sample.acceleration_m_s2)
        elif (
            isinstance(sample, VibrationSample)
            and sample.statistic == "instantaneous"
            and sample.quantity == "acceleration"
        ):
            self._append(sample.t_ns, VIBRATION_FRAME, sample.amplitude)

    def up_until(self, t_ns: int) -> Float64Array | None:
        """Return (3,) the unit vector upwards, in the body's axes, since the last call.

        The mean of all accelerations up to `t_ns`, which are then forgotten; None without any.
        """
        total = np.zeros(3)
        while self._forces and self._forces[0][0] <= t_ns:
            _, frame, force = self._forces.popleft()
            total += self._to_body(frame) @ force
        length = float(np.linalg.norm(total))
        return total / length if np.isfinite(length) and length > 0.0 else None

    def _append(self, t_ns: int, frame: str, force: Float64Array) -> None:
        self._forces.append((t_ns, frame, force))
        while t_ns - self._forces[0][0] > _HISTORY_NS:
            self._forces.popleft()

    def _to_body(self, frame: str) -> Float64Array:
        """Return C_body_sensor; zeros where it is not known."""
        if frame not in self._axes:
            if self._mounts.connects(self._body_frame, frame):
                self._axes[frame] = self._mounts.lookup(self._body_frame, frame).rotation
            else:
                self._axes[frame] = np.eye(3) * float(self._body_frame == BASE_FRAME)
        return self._axes[frame]
