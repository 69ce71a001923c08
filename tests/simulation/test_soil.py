import numpy as np
import pytest
from numpy.typing import NDArray

from simulation.vehicle.soil import BODY_COLUMNS, Soil, plate_elements, press, rim_elements
from tests.simulation.grounds import sloping

# A plate of 0.2 x 0.1 m that looks down, in 40 elements.
PLATE = plate_elements((0.0, 0.0, 0.0), (0.0, 0.1, 0.0), (0.2, 0.0, 0.0), (4, 10))
STIFFNESS = 1400.0 / 0.1 + 820e3
DT_S = 0.0005


def body(z_m: float, velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> NDArray[np.float64]:
    state = np.zeros(BODY_COLUMNS)
    state[2] = z_m
    state[3:12] = np.eye(3).ravel()
    state[12:15] = velocity
    return state


def wrench_on_plate(
    state: NDArray[np.float64],
    slipped: NDArray[np.float64] | None = None,
    grip: float = 1.0,
    degrees: float = 0.0,
) -> NDArray[np.float64]:
    grid = sloping(degrees, 1.0)
    wrench = np.empty(6)
    press(
        (grid.height_m, grid.origin_x_m, grid.origin_y_m, grid.spacing_m),
        Soil().constants(),
        STIFFNESS,
        grip,
        PLATE,
        np.zeros((len(PLATE), 2)) if slipped is None else slipped,
        state,
        DT_S,
        wrench,
    )
    return wrench


def test_elements_cover_their_surface() -> None:
    assert PLATE[:, 12].sum() == pytest.approx(0.02)
    np.testing.assert_allclose(PLATE[:, 3:6], np.tile([0.0, 0.0, -1.0], (40, 1)))
    np.testing.assert_allclose(np.ptp(PLATE[:, :3], axis=0), [0.18, 0.075, 0.0])
    rim = rim_elements(0.1, 0.04, 72, 3)
    assert rim[:, 12].sum() == pytest.approx(2 * np.pi * 0.1 * 0.04)
    np.testing.assert_allclose(rim[:, 3:6].sum(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.cross(rim[:, 3:6], rim[:, 9:12]), -rim[:, 6:9], atol=1e-12)


def test_a_plate_at_rest_feels_bekkers_pressure() -> None:
    wrench = wrench_on_plate(body(-0.01))
    np.testing.assert_allclose(wrench[:3], [0.0, 0.0, STIFFNESS * 0.01 * 0.02], rtol=1e-5)
    np.testing.assert_allclose(wrench[3:], 0.0, atol=1e-9)


@pytest.mark.parametrize("state", [body(0.001), body(np.nan)])
def test_nothing_presses_above_the_ground_or_without_one(state: NDArray[np.float64]) -> None:
    assert not wrench_on_plate(state).any()


def test_outside_the_grid_there_is_no_force() -> None:
    state = body(-0.1)
    state[0] = 5.0
    assert not wrench_on_plate(state).any()


def test_depth_counts_along_the_grounds_normal() -> None:
    wrench = wrench_on_plate(body(-0.02), degrees=5.0)
    depth = 0.02 * np.cos(np.radians(5.0))
    assert wrench[2] == pytest.approx(STIFFNESS * depth * 0.02, rel=1e-3)


def test_shear_grows_with_the_slip_to_coulombs_limit_and_remembers() -> None:
    soil = Soil()
    slipped = np.zeros((len(PLATE), 2))
    sliding = body(-0.01, (0.1, 0.0, 0.0))
    forces = [wrench_on_plate(sliding, slipped)[0] for _ in range(2000)]
    pressure = STIFFNESS * 0.01
    limit = soil.sideways * (soil.cohesion_pa + pressure * np.tan(soil.friction_rad)) * 0.02
    assert np.all(np.diff(forces[:200]) < 0.0)  # x is this plate's second direction
    assert forces[-1] == pytest.approx(-limit, rel=1e-6)
    held = wrench_on_plate(body(-0.01), slipped)[0]
    assert held == pytest.approx(-limit * (1.0 - np.exp(-3.0)), rel=1e-6)


def test_grip_scales_the_shear_alone() -> None:
    slipped = np.full((len(PLATE), 2), 0.01)
    full = wrench_on_plate(body(-0.01), slipped.copy())
    less = wrench_on_plate(body(-0.01), slipped.copy(), grip=0.2)
    np.testing.assert_allclose(less[:2], 0.2 * full[:2])
    assert less[2] == full[2]


def test_soil_that_is_left_pushes_less_than_soil_that_is_entered() -> None:
    entering, leaving = (wrench_on_plate(body(-0.01, (0.0, 0.0, v)))[2] for v in (-1.0, 1.0))
    soil = Soil()
    assert leaving / entering == pytest.approx(
        (1.0 - soil.compaction) / (1.0 + soil.compaction), rel=1e-6
    )
