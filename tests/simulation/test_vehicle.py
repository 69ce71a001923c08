import numpy as np
import pytest
from numpy.typing import NDArray

from simulation.errors import SimulationError
from simulation.terrain.height_grid import HeightGrid
from simulation.vehicle import jackal
from simulation.vehicle.vehicle import Contact, Disturbance, Vehicle
from tests.simulation.grounds import bumpy, sloping

FREE = Disturbance()
STILL = np.zeros(4)


def rates(left_m_s: float, right_m_s: float) -> NDArray[np.float64]:
    return np.array([left_m_s, left_m_s, right_m_s, right_m_s]) / jackal.WHEEL_RADIUS_M


def drive(
    vehicle: Vehicle, left_m_s: float, right_m_s: float, ramp_ms: int = 700, steady_ms: int = 500
) -> tuple[NDArray[np.float64], float, float]:
    """Return mean wheel rates, speed and yaw rate after a ramp."""
    goal = rates(left_m_s, right_m_s)
    for i in range(ramp_ms):
        vehicle.advance(goal * i / ramp_ms, FREE)
    seen = []
    for _ in range(steady_ms):
        vehicle.advance(goal, FREE)
        speed = np.hypot(*vehicle.velocity_m_s[:2])
        seen.append([*vehicle.wheel_rate_rad_s, speed, vehicle.body_rate_rad_s[2]])
    means = np.mean(seen, axis=0)
    return means[:4], float(means[4]), float(means[5])


def test_the_mass_is_that_of_the_description() -> None:
    assert Vehicle(sloping(half_size_m=1.0)).mass_kg == pytest.approx(18.43, abs=0.005)


@pytest.mark.parametrize("contact", ["soil", "native"])
@pytest.mark.parametrize("ground", [sloping(), sloping(12.0), bumpy()], ids=["flat", "12", "bumpy"])
def test_at_rest_it_neither_trembles_nor_creeps(contact: Contact, ground: HeightGrid) -> None:
    vehicle = Vehicle(ground, contact)
    vehicle.place(0.0, 0.0, 0.4)
    start = vehicle.position_m
    forces, turning = [], []
    for _ in range(300):
        vehicle.advance(STILL, FREE)
        forces.append(vehicle.acceleration_m_s2)
        turning.append(vehicle.body_rate_rad_s)
    assert np.sqrt(np.var(forces, axis=0).sum()) < 0.05
    assert np.linalg.norm(np.mean(forces, axis=0)) == pytest.approx(9.80665, abs=0.005)
    assert np.linalg.norm(vehicle.position_m - start) / 0.3 < 0.001
    assert np.abs(turning).max() < 0.003


def test_on_level_ground_it_rolls_as_far_as_its_wheels_say() -> None:
    vehicle = Vehicle(sloping())
    vehicle.place(0.0, 0.0, 0.0)
    wheels, speed, yaw_rate = drive(vehicle, 0.3, 0.3)
    slip = 1.0 - speed / (wheels.mean() * jackal.WHEEL_RADIUS_M)
    assert wheels == pytest.approx(rates(0.3, 0.3), rel=0.01)
    assert slip == pytest.approx(0.0, abs=0.03)
    assert abs(yaw_rate) < 0.002


def test_uphill_the_wheels_slip_more() -> None:
    vehicle = Vehicle(sloping(12.0))
    vehicle.place(0.0, 0.0, 0.0)
    wheels, speed, _ = drive(vehicle, 0.3, 0.3)
    horizontal = wheels.mean() * jackal.WHEEL_RADIUS_M * np.cos(np.radians(12.0))
    assert 0.08 < 1.0 - speed / horizontal < 0.3


@pytest.mark.parametrize(("left", "right"), [(-0.3, 0.3), (0.2, 0.4)])
def test_it_turns_as_if_its_track_were_wider(left: float, right: float) -> None:
    vehicle = Vehicle(sloping())
    vehicle.place(0.0, 0.0, 0.0)
    wheels, _, yaw_rate = drive(vehicle, left, right)
    left_m_s, right_m_s = wheels.reshape(2, 2).mean(axis=1) * jackal.WHEEL_RADIUS_M
    assert (right_m_s - left_m_s) / yaw_rate / jackal.TRACK_M == pytest.approx(1.43, abs=0.07)


@pytest.mark.parametrize("contact", ["soil", "native"])
def test_without_grip_the_wheels_spin(contact: Contact) -> None:
    vehicle = Vehicle(sloping(), contact)
    vehicle.place(0.0, 0.0, 0.0)
    for _ in range(500):
        vehicle.advance(rates(0.3, 0.3), Disturbance(grip=np.full(4, 0.005)))
    assert vehicle.wheel_rate_rad_s == pytest.approx(rates(0.3, 0.3), rel=0.05)
    assert np.hypot(*vehicle.velocity_m_s[:2]) < 0.05


def test_a_push_gives_its_impulse() -> None:
    vehicle = Vehicle(sloping(), gravity_m_s2=9.80665)
    vehicle.place(0.0, 0.0, 0.0)
    vehicle.advance(STILL, Disturbance(force_n=np.array([0.0, 0.0, 18.431 * 50.0])))
    assert vehicle.velocity_m_s[2] == pytest.approx(0.05, rel=0.1)


def test_it_refuses_to_start_or_drive_off_the_ground() -> None:
    vehicle = Vehicle(sloping(half_size_m=1.0))
    with pytest.raises(SimulationError, match="no ground under the wheels"):
        vehicle.place(1.0, 0.0, 0.0)
    vehicle.place(0.4, 0.0, 0.0)
    with pytest.raises(SimulationError, match="reached the ground's edge"):
        drive(vehicle, 1.0, 1.0)


def test_it_says_when_it_fell_over() -> None:
    x = 0.02 * np.arange(401) - 4.0
    cliff = np.tile(np.where(x < 0.3, 0.0, -0.9)[:, np.newaxis], (1, 401))
    vehicle = Vehicle(HeightGrid(-4.0, -4.0, 0.02, cliff.astype(np.float32)))
    vehicle.place(0.0, 0.0, 1.2)
    with pytest.raises(SimulationError, match="fell over"):
        drive(vehicle, 0.4, 0.4, steady_ms=3000)
