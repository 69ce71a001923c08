import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.samples import DepthFrame
from simulation.devices.depth_faults import with_patches
from simulation.devices.kinect import kinect_320
from simulation.errors import SimulationError
from simulation.faults import (
    AccelerometerBias,
    BlindPatches,
    Dropout,
    Fault,
    Shock,
    Slip,
    SpinningWheels,
    Unplug,
    arriving,
)
from simulation.motion import Motion
from simulation.vehicle.drive_commands import Line
from simulation.vehicle.jackal import WHEEL_RADIUS_M
from simulation.vehicle.vehicle_run import DriveOptions, simulate_vehicle
from tests.simulation.grounds import sloping

TIMES_S = np.asarray(np.arange(1000) * 0.01, np.float64)


def kept(*faults: Fault) -> NDArray[np.bool_]:
    return arriving(faults, "gyro", TIMES_S, np.random.default_rng(1))


def test_an_unplugged_device_is_silent_and_comes_back() -> None:
    through = kept(Unplug(device="gyro", start_s=2.0, duration_s=3.0))
    np.testing.assert_array_equal(through, (TIMES_S < 2.0) | (TIMES_S >= 5.0))
    assert not kept(Unplug(device="gyro", start_s=0.0)).any()


def test_a_dropout_loses_its_share() -> None:
    through = kept(Dropout(device="gyro", start_s=5.0, share=0.3))
    assert through[:500].all()
    assert through[500:].mean() == pytest.approx(0.7, abs=0.06)


def test_faults_leave_other_devices_alone() -> None:
    assert kept(Unplug(device="mocap", start_s=0.0), Slip(start_s=0.0)).all()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Unplug(device="sonar", start_s=0.0), "no device 'sonar'"),  # type: ignore[arg-type] # that is the point
        (lambda: Dropout(device="gyro", start_s=-1.0), "start_s -1"),
        (lambda: Dropout(device="gyro", start_s=0.0, share=1.5), "share"),
        (lambda: Slip(start_s=0.0, duration_s=0.0), "duration_s 0"),
        (lambda: Slip(start_s=0.0, grip=-0.1), "grip"),
        (lambda: Slip(start_s=0.0, wheels=(4,)), "wheels"),
        (lambda: SpinningWheels(start_s=0.0, speed_m_s=9.0), "speed_m_s"),
        (lambda: AccelerometerBias(start_s=0.0, bias_m_s2=(0.0, math.nan, 0.0)), "bias_m_s2"),
        (lambda: BlindPatches(start_s=0.0, size=0.0), "size is 0"),
        (lambda: BlindPatches(start_s=0.0, patches=0), "patches is 0"),
        (lambda: Shock(start_s=0.0, duration_s=5.0), "duration_s 5"),
        (lambda: Shock(start_s=0.0, velocity_change_m_s=(9.0, 0.0, 0.0)), "velocity_change"),
    ],
)
def test_impossible_faults(make: Callable[[], object], message: str) -> None:
    with pytest.raises(SimulationError, match=message):
        make()


def blind(frame: int, *faults: Fault, t_s: float = 1.0) -> NDArray[np.bool_]:
    """Return which readings of a full image are lost."""
    depth_mm = np.full((240, 320), 1500, np.uint16)
    seen = DepthFrame(7, depth_mm, kinect_320(), frame)
    after = with_patches(seen, faults, t_s, seed=3)
    assert depth_mm.all()
    assert set(np.unique(after.depth_mm)) <= {0, 1500}
    assert not after.depth_mm.flags.writeable or after is seen
    return np.asarray(after.depth_mm == 0)


def test_dust_takes_other_readings_in_every_frame_and_glare_the_same() -> None:
    dust, glare = BlindPatches(start_s=1.0), BlindPatches(start_s=0.0, patches=1, moving=False)
    first, second = blind(1, dust), blind(2, dust)
    assert (first != second).any()
    assert 0.0 < first.mean() <= 5 * 48**2 / (240 * 320)
    np.testing.assert_array_equal(blind(1, glare), blind(2, glare))
    np.testing.assert_array_equal(blind(1, dust, glare) >= first, True)
    assert not blind(1, dust, t_s=0.9).any()
    assert not blind(1, Unplug(device="depth", start_s=0.0)).any()


def drive(*faults: Fault) -> Motion:
    options = DriveOptions(rest_s=0.5, faults=faults)
    return simulate_vehicle(sloping(half_size_m=2.0), Line(0.3), 3.0, 1, options).motion


def test_a_shock_gives_its_change_of_velocity() -> None:
    motion = drive(Shock(start_s=0.2, velocity_change_m_s=(0.0, 0.0, 0.2)))
    # The soil pulls nothing back while the vehicle rises, so its weight is missing for 10 ms.
    change = motion.velocity_m_s[210, 2] - motion.velocity_m_s[200, 2]
    assert change == pytest.approx(0.2, abs=0.1)
    assert motion.acceleration_m_s2[200:211, 2].max() > 20.0
    assert abs(motion.velocity_m_s[199, 2]) < 1e-4


def test_spinning_wheels_turn_in_place() -> None:
    motion = drive(SpinningWheels(start_s=1.5, speed_m_s=0.3))
    rims = motion.wheel_rate_rad_s[-500:] * WHEEL_RADIUS_M
    assert rims == pytest.approx(0.3, abs=0.02)
    moved = motion.position_m[-1] - motion.position_m[-500]
    assert np.linalg.norm(moved) < 0.002


def test_slippery_ground_delays_the_start() -> None:
    usual, slippery = drive(), drive(Slip(start_s=0.0, grip=0.05))
    assert slippery.position_m[-1, 0] < 0.8 * usual.position_m[-1, 0]
    assert slippery.wheel_rate_rad_s[-1] == pytest.approx(usual.wheel_rate_rad_s[-1], rel=0.05)


def test_wheels_of_one_side_that_slip_turn_the_vehicle() -> None:
    motion = drive(Slip(start_s=0.5, grip=0.02, wheels=(2, 3)))
    assert motion.body_rate_rad_s[600:1000, 2].min() < -0.005
