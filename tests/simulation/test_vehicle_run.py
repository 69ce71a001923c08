import hashlib

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.samples import AccelerationSample, CanFrameSample, YawRateSample
from simulation.errors import SimulationError
from simulation.faults import Unplug
from simulation.motion import Motion
from simulation.vehicle.drive_commands import Arc, PlanarPose, SCurve, Waypoints
from simulation.vehicle.vehicle_run import DriveOptions, VehicleRun, simulate_vehicle
from tests.simulation.grounds import bumpy, sloping

SHORT = DriveOptions(rest_s=1.0)


@pytest.fixture(scope="module")
def run() -> VehicleRun:
    return simulate_vehicle(bumpy(), SCurve(0.4, 0.8, 4.0), 6.0, 7, SHORT)


def fingerprint() -> str:
    """Hash of everything that a run gives."""
    run = simulate_vehicle(bumpy(), Waypoints([(1.0, 0.2)]), 1.5, 11, SHORT)
    digest = hashlib.sha256()
    for sample in run.samples():
        digest.update(repr(sample).encode())
    for rows in (run.motion.position_m, run.motion.quat_wxyz, run.motion.acceleration_m_s2):
        digest.update(rows.tobytes())
    return digest.hexdigest()


def test_the_same_seed_gives_the_same_bytes_again() -> None:
    """For another process see `tests/test_cli.py`, which simulates all devices in one."""
    assert fingerprint() == fingerprint()


def test_another_seed_changes_the_devices_and_not_the_physics() -> None:
    one, two = (simulate_vehicle(sloping(), SCurve(), 1.5, seed, SHORT) for seed in (1, 2))
    np.testing.assert_array_equal(one.motion.position_m, two.motion.position_m)
    assert repr(next(one.samples())) != repr(next(two.samples()))


def test_it_begins_at_rest(run: VehicleRun) -> None:
    still = slice(0, 1000)
    motion = run.motion
    assert not motion.command[still].any()
    assert np.sqrt(np.var(motion.acceleration_m_s2[still], axis=0).sum()) < 0.05
    assert np.linalg.norm(motion.position_m[1000] - motion.position_m[0]) < 0.001
    assert np.abs(motion.body_rate_rad_s[still]).max() < 0.003
    assert np.linalg.norm(motion.velocity_m_s[3000:], axis=1).mean() > 0.3


def test_the_accelerometer_is_the_derivative_of_the_velocity(run: VehicleRun) -> None:
    assert_felt_is_derivative(run.motion, 1000)


def test_it_is_so_on_hard_ground_too() -> None:
    options = DriveOptions(rest_s=0.5, contact="native")
    run = simulate_vehicle(sloping(8.0), Arc(0.4, -0.6), 1.7, 7, options)
    assert_felt_is_derivative(run.motion, 500)


def assert_felt_is_derivative(motion: Motion, first: int) -> None:
    rotation = Rotation.from_quat(motion.quat_wxyz, scalar_first=True)
    turning = np.cross(motion.body_rate_rad_s, SHORT.accelerometer.position_m)
    at_sensor = motion.velocity_m_s + rotation.apply(turning)
    derivative = np.diff(at_sensor, axis=0) * 1000.0
    felt = rotation[1:].apply(motion.acceleration_m_s2[1:].copy()) - [0.0, 0.0, 9.80665]
    for axis in range(3):
        assert np.corrcoef(felt[first:, axis], derivative[first:, axis])[0, 1] > 0.99
    assert felt[first:].std(axis=0).min() > 0.02


def test_velocity_and_rates_are_the_derivatives_of_the_pose(run: VehicleRun) -> None:
    motion = run.motion
    velocity = np.diff(motion.position_m, axis=0) * 1000.0
    np.testing.assert_allclose(velocity, motion.velocity_m_s[1:], atol=0.01)
    rotation = Rotation.from_quat(motion.quat_wxyz, scalar_first=True)
    rate = (rotation[:-1].inv() * rotation[1:]).as_rotvec() * 1000.0
    np.testing.assert_allclose(rate, motion.body_rate_rad_s[1:], atol=0.05)


def test_samples_come_in_the_order_of_their_stamps(run: VehicleRun) -> None:
    stamps = [sample.t_ns for sample in run.samples()]
    assert stamps == sorted(stamps)
    assert len(stamps) == sum(map(len, run.streams))
    counts = {stream.kind.__name__: len(stream) for stream in run.streams}
    assert counts == pytest.approx(
        {
            "AccelerationSample": 6000,
            "VibrationSample": 574,
            "YawRateSample": 1200,
            "CanFrameSample": 1200,
            "WheelTwistSample": 300,
            "PoseSample": 600,
        },
        abs=5,
    )


def test_devices_report_the_motion(run: VehicleRun) -> None:
    gyro = next(stream for stream in run.streams if stream.kind is YawRateSample)
    rates = np.array([s.rate_rad_s for s in gyro if isinstance(s, YawRateSample)])
    true = np.interp(
        run.motion.elapsed_s(gyro.measured_ns),
        np.arange(6001) * 1e-3,
        run.motion.body_rate_rad_s[:, 2],
    )
    errors = rates - true
    assert np.corrcoef(rates, true)[0, 1] > 0.999
    assert abs(np.median(errors)) < 0.03
    assert errors.std() < 0.01


def test_an_unplugged_device_is_missing_from_the_run() -> None:
    fault = Unplug(device="wheels", start_s=1.2, duration_s=0.2)
    options = DriveOptions(rest_s=1.0, faults=(fault,))
    run = simulate_vehicle(sloping(), SCurve(), 1.6, 1, options)
    times = [s.t_ns - options.start_ns for s in run.samples() if isinstance(s, CanFrameSample)]
    gaps = np.diff(times) * 1e-9
    assert gaps.max() == pytest.approx(0.2, abs=0.03)
    assert any(isinstance(sample, AccelerationSample) for sample in run.samples())


def test_progress_is_told() -> None:
    seconds: list[float] = []
    simulate_vehicle(sloping(), SCurve(), 1.1, 1, SHORT, seconds.append)
    assert seconds == pytest.approx(np.arange(0.0, 1.1, 0.02))


@pytest.mark.parametrize(
    ("seconds", "seed", "options", "message"),
    [
        (1.0, 1, SHORT, "run of 1.0 s; expected more than the 1 s of rest"),
        (1e6, 1, SHORT, "run of 1000000.0 s"),
        (float("nan"), 1, SHORT, "run of nan s"),
        (2.0, -1, SHORT, "seed -1"),
        (2.0, 1, DriveOptions(start=PlanarPose(50.0, 0.0, 0.0)), "run of 2.0 s"),
        (4.0, 1, DriveOptions(start=PlanarPose(50.0, 0.0, 0.0)), "no ground under the wheels"),
    ],
)
def test_impossible_runs(seconds: float, seed: int, options: DriveOptions, message: str) -> None:
    with pytest.raises(SimulationError, match=message):
        simulate_vehicle(sloping(half_size_m=1.0), SCurve(), seconds, seed, options)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"contact": "mud"}, "contact"),
        ({"rest_s": 0.0}, "rest_s"),
        ({"gravity_m_s2": 0.0}, "gravity"),
    ],
)
def test_impossible_options(settings: dict[str, object], message: str) -> None:
    with pytest.raises(SimulationError, match=message):
        DriveOptions(**settings)  # type: ignore[arg-type] # that is the point
