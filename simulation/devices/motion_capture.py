"""What a motion capture system reports of a motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from drivers.samples import PoseSample, Sample, frozen_array
from simulation.devices.device_stream import DeviceClock, DeviceStream
from simulation.faults import Fault, arriving
from simulation.motion import Motion


@dataclass(frozen=True, slots=True)
class MotionCapture:
    """A system that tracks the body frame R in the world.

    Attributes:
        clock: how it keeps time; the latency is that of its cameras and the network.
        position_sigma_m: white noise of each coordinate.
        rotation_sigma_rad: white noise of the rotation about each axis.
    """

    clock: DeviceClock = field(
        default_factory=lambda: DeviceClock(100.0, drift_ppm=-10.0, latency_s=0.006, jitter_s=5e-4)
    )
    position_sigma_m: float = 0.001
    rotation_sigma_rad: float = 0.005


def pose_stream(
    motion: Motion, system: MotionCapture, faults: Sequence[Fault], random: np.random.Generator
) -> DeviceStream:
    """Return the poses as samples, with the covariance of their noise."""
    measured_ns = system.clock.edges_ns(motion.start_ns, motion.duration_ns, random)[1:]
    position, quat = motion.pose_at(measured_ns)
    position += system.position_sigma_m * random.standard_normal(position.shape)
    turned = system.rotation_sigma_rad * random.standard_normal(position.shape)
    rotation = Rotation.from_rotvec(turned) * Rotation.from_quat(quat, scalar_first=True)
    quat = rotation.as_quat(scalar_first=True)
    variances = [system.position_sigma_m**2] * 3 + [system.rotation_sigma_rad**2] * 3
    covariance = frozen_array(np.diag(variances), (6, 6))
    t_ns = system.clock.stamps_ns(measured_ns, random)

    def make(index: int, sequence: int) -> Sample:
        """Return that pose; position in metres."""
        return PoseSample(
            int(t_ns[index]),
            frozen_array(position[index], (3,)),
            frozen_array(quat[index], (4,)),
            covariance,
            sequence,
        )

    arrived = arriving(faults, "mocap", motion.elapsed_s(measured_ns), random)
    return DeviceStream("mocap", PoseSample, measured_ns, arrived, make)
