"""Whether the variance is true: one source of error at a time, drawn anew for every run."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from drivers.samples import DepthFrame, PoseSample
from mapping.judging.evaluation import CONFIRMED
from mapping.mapper import Mapper
from mapping.noise import DepthNoiseModel
from mapping.settings import MapSettings
from tests.mapping.scenes import (
    CAMERA,
    NO_COVARIANCE,
    looking,
    millimetres,
    mount,
    plane_z,
    pose_sample,
)

Float64Array = NDArray[np.float64]

RUNS = 40
NOISE = DepthNoiseModel("white", axial_offset_m=0.002)
CORRELATION_S = 0.3
# z 10 mm, roll and pitch 0.6 degrees, correlated with each other.
_SHAPE = np.eye(6)
_SHAPE[2, 3], _SHAPE[3, 4] = 0.5, -0.5
POSE_ROOT = np.diag([0.0, 0.0, 0.01, 0.01, 0.01, 0.02]) @ _SHAPE


def _views(count: int) -> Iterator[tuple[Float64Array, Float64Array]]:
    """Give rotation and position of cameras that look at one place from all around."""
    for k in range(count):
        yaw = math.radians(40.0 * k)
        position = np.array([-1.5 * math.cos(yaw), -1.5 * math.sin(yaw), 0.8])
        yield looking(40.0 * k, 35.0, 3.0), position


def _floor(rotation: Float64Array, position: Float64Array) -> Float64Array:
    return plane_z(CAMERA, rotation, (0.0, 0.0, 1.0), -float(position[2]))


def _measured(z_m: Float64Array, random: np.random.Generator) -> NDArray[np.uint16]:
    noisy = z_m + 0.002 * random.standard_normal(z_m.shape)
    return millimetres(np.where(z_m > 0.0, np.clip(noisy, 0.0, 60.0), 0.0))


def _anees(mapper: Mapper) -> float:
    """Return the mean of (height / sigma)^2 of a map of the floor z = 0."""
    map_ = mapper.elevation_map()
    confirmed = np.isin(map_.state, CONFIRMED)
    assert confirmed.sum() > 50
    return float(np.mean(map_.elevation_m[confirmed] ** 2 / map_.variance_m2[confirmed]))


def test_pixel_noise() -> None:
    found = []
    for seed in range(10):
        random = np.random.default_rng(seed)
        mapper = Mapper(MapSettings(resolution_m=0.1), NOISE)
        mapper.add(mount())
        for k, (rotation, position) in enumerate(_views(6)):
            depth = _measured(_floor(rotation, position), random)
            mapper.add(pose_sample(k * 10**9, position, rotation))
            mapper.add(DepthFrame(k * 10**9, depth, CAMERA, k))
        found.append(_anees(mapper))
    assert 0.6 < np.mean(found) < 1.2


def test_depth_bias() -> None:
    """One draw for the whole run; 5 mm + 2 mm/m^2 z^2, seen from all around."""
    noise = replace(NOISE, bias_sigma_m=0.005, bias_sigma_quadratic_per_m=0.002)
    found = []
    for seed in range(RUNS):
        random = np.random.default_rng(seed)
        draw = random.standard_normal()
        mapper = Mapper(MapSettings(resolution_m=0.1), noise)
        mapper.add(mount())
        for k, (rotation, position) in enumerate(_views(6)):
            z_m = _floor(rotation, position)
            z_m += np.where(z_m > 0.0, draw * (0.005 + 0.002 * z_m**2), 0.0)
            mapper.add(pose_sample(k * 10**9, position, rotation))
            mapper.add(DepthFrame(k * 10**9, _measured(z_m, random), CAMERA, k))
        found.append(_anees(mapper))
    assert 0.6 < np.mean(found) < 1.5


def test_a_crooked_mount() -> None:
    """0.6 degrees about each axis of the sensor, the same for the whole run."""
    settings = MapSettings(resolution_m=0.1, mount_sigma_rad=0.01)
    found = []
    for seed in range(RUNS):
        random = np.random.default_rng(seed)
        crooked = Rotation.from_rotvec(0.01 * random.standard_normal(3)).as_matrix()
        mapper = Mapper(settings, NOISE)
        mapper.add(mount())
        for k, (rotation, position) in enumerate(_views(6)):
            depth = _measured(_floor(rotation @ crooked, position), random)
            mapper.add(pose_sample(k * 10**9, position, rotation))
            mapper.add(DepthFrame(k * 10**9, depth, CAMERA, k))
        found.append(_anees(mapper))
    assert 0.5 < np.mean(found) < 1.4


def _wrong_poses(
    frames: int, period_s: float, random: np.random.Generator
) -> Iterator[tuple[PoseSample, Float64Array]]:
    """Give poses whose errors fade with the correlation time, and what is really seen."""
    keep = math.exp(-period_s / CORRELATION_S)
    covariance = POSE_ROOT @ POSE_ROOT.T
    error = POSE_ROOT @ random.standard_normal(6)
    for k, (rotation, position) in enumerate(_views(frames)):
        fresh = POSE_ROOT @ random.standard_normal(6)
        error = keep * error + math.sqrt(1.0 - keep**2) * fresh if k else error
        turn = Rotation.from_rotvec(-error[3:]).as_matrix()
        z_m = _floor(turn @ rotation, position - error[:3])
        t_ns = round(k * period_s * 1e9)
        yield pose_sample(t_ns, position, rotation, covariance), z_m


@pytest.mark.parametrize(("frames", "period_s"), [(6, 1.0), (12, 0.3), (20, 0.1)])
def test_pose_errors_fresh_and_alike(frames: int, period_s: float) -> None:
    found = []
    for seed in range(RUNS):
        random = np.random.default_rng(seed)
        mapper = Mapper(MapSettings(resolution_m=0.1), NOISE)
        mapper.add(mount())
        for pose, z_m in _wrong_poses(frames, period_s, random):
            mapper.add(pose)
            mapper.add(DepthFrame(pose.t_ns, _measured(z_m, random), CAMERA, 0))
        found.append(_anees(mapper))
    assert 0.6 < np.mean(found) < 1.5


def test_a_pose_without_its_covariance_makes_the_map_overconfident() -> None:
    """That the tests above can fail: the same errors, kept from the mapper."""
    random = np.random.default_rng(0)
    mapper = Mapper(MapSettings(resolution_m=0.1), NOISE)
    mapper.add(mount())
    for pose, z_m in _wrong_poses(6, 1.0, random):
        mapper.add(replace(pose, covariance=NO_COVARIANCE))
        mapper.add(DepthFrame(pose.t_ns, _measured(z_m, random), CAMERA, 0))
    assert _anees(mapper) > 20.0
