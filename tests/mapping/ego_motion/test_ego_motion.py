"""Ego-motion as a whole: samples in, poses out."""

from __future__ import annotations

import numpy as np

from mapping.ego_motion.ego_motion import EgoMotion
from mapping.ego_motion.settings import EgoMotionSettings
from tests.mapping.ego_motion.drives import START_NS, Drive, replay

NO_DELAY = EgoMotionSettings(
    gyro_delay_s=0.0, wheels_delay_s=0.0, acceleration_delay_s=0.0, vibration_delay_s=0.0
)


def test_a_drive_is_followed_within_its_sigma() -> None:
    drive = Drive()
    ego = EgoMotion(NO_DELAY)
    for seconds, pose in replay(ego, drive.samples()):
        x, y, _ = pose.transform.translation_m
        true = drive.truth(np.array([seconds]))[0]
        sigma = np.sqrt(pose.covariance.diagonal())
        assert abs(x - true[0]) < 3.0 * sigma[0] + 0.005
        assert abs(y - true[1]) < 3.0 * sigma[1] + 0.005
    assert np.hypot(x - true[0], y - true[1]) < 0.02
    assert 0.02 < np.hypot(*sigma[:2]) < 0.1
    assert not ego.events


def test_relative_covariance_is_smaller_than_that_of_the_pose() -> None:
    ego = EgoMotion(NO_DELAY)
    for _ in replay(ego, Drive().samples()):
        pass
    t1_ns = START_NS + 10_003_000_000
    later = ego.pose_at(t1_ns)
    assert later is not None
    relative = ego.relative_covariance(t1_ns - 100_000_000, t1_ns)
    assert np.linalg.eigvalsh(relative.covariance).min() >= -1e-18
    assert relative.covariance[0, 0] < 0.01 * later.covariance[0, 0]
    assert relative.transform.translation_m[0] > 0.025
