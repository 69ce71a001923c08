import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.samples import PoseSample
from simulation.devices.motion_capture import MotionCapture, pose_stream
from tests.simulation.motions import motion


def test_poses_have_the_noise_that_their_covariance_tells() -> None:
    system = MotionCapture(position_sigma_m=0.002, rotation_sigma_rad=0.01)
    still = motion(20.0, position_m=(1.0, 2.0, 3.0))
    stream = pose_stream(still, system, (), np.random.default_rng(4))
    poses = [pose for pose in stream if isinstance(pose, PoseSample)]
    errors = np.array([pose.position_m for pose in poses]) - [1.0, 2.0, 3.0]
    turns = Rotation.from_quat([p.quat_wxyz for p in poses], scalar_first=True).as_rotvec()
    both = np.hstack([errors, turns])
    assert both.std(axis=0) == pytest.approx([0.002] * 3 + [0.01] * 3, rel=0.06)
    assert np.sqrt(np.diag(poses[0].covariance)) == pytest.approx([0.002] * 3 + [0.01] * 3)
    assert np.linalg.norm(poses[0].quat_wxyz) == pytest.approx(1.0, abs=1e-12)
    lateness = np.array([pose.t_ns for pose in poses]) - stream.measured_ns
    assert len(poses) == pytest.approx(2000, abs=1)
    assert lateness.min() >= 6_000_000
    assert lateness.mean() == pytest.approx(6_500_000, rel=0.02)
