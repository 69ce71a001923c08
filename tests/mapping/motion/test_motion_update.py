"""Motions and measurements of one cell in turn: the kernel against a sweep after every motion."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mapping.motion.ledger import MotionLedger
from mapping.motion.pose_errors import RELATIVE
from mapping.motion.read_out import Rover, place_errors
from mapping.motion.relative import RelativeMotion
from tests.mapping.cells import Cell, Seen
from tests.mapping.motion.sweep import growth

Float64Array = NDArray[np.float64]

# Where the middle of the cell of `tests.mapping.cells` is in T.
CELL_M = np.array([0.0, 1.0, 0.0])
OPEN = {"gate_sigma": 1e6, "sigma_floor_m": 1e-6, "sigma_ceiling_m": 100.0}

roots = st.tuples(*[st.floats(-0.05, 0.05)] * 16).map(lambda v: np.reshape(v, (4, 4)))
motions = st.builds(
    lambda root, x, y, yaw, way: RelativeMotion(0, np.array([x, y, 0.2]), yaw, root @ root.T, way),
    roots,
    st.floats(-5.0, 5.0),
    st.floats(-5.0, 5.0),
    st.floats(-math.pi, math.pi),
    st.floats(0.0, 0.5),
)
steps = st.tuples(st.lists(motions, max_size=4), st.floats(1e-6, 1e-2))


@dataclass
class Swept:
    """A cell that every motion visits."""

    variance_m2: float
    horizontal_m2: Float64Array
    stale_m: float = 0.0

    def move(self, motion: RelativeMotion) -> None:
        added = growth(motion, CELL_M)
        self.horizontal_m2 = self.horizontal_m2 + added[:2, :2]
        self.variance_m2 += added[2, 2]
        self.stale_m += motion.distance_m

    def see(self, own_m2: float) -> None:
        gain = self.variance_m2 / (self.variance_m2 + own_m2)
        self.variance_m2 *= 1.0 - gain
        self.horizontal_m2 = (1.0 - gain) ** 2 * self.horizontal_m2
        self.stale_m *= 1.0 - gain


@given(st.lists(steps, min_size=1, max_size=6))
def test_the_lazy_update_is_the_sweep(taken: list[tuple[list[RelativeMotion], float]]) -> None:
    cell, ledger = Cell(**OPEN), MotionLedger(with_covariance=True)
    cell.see(Seen(0.0, 1e-3))
    swept = Swept(1e-3, np.zeros((2, 2)))
    for between, own_m2 in taken:
        for motion in between:
            ledger.add(motion)
            swept.move(motion)
        cell.see(Seen(0.0, own_m2), ledger.motions)
        swept.see(own_m2)
        found = [cell.horizontal_xx_m2, cell.horizontal_xy_m2, cell.horizontal_yy_m2]
        expected = swept.horizontal_m2.ravel()[[0, 1, 3]]
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-9)
        assert cell.variance_m2 == pytest.approx(swept.variance_m2, rel=1e-4, abs=1e-12)
        assert cell.stale_m == pytest.approx(swept.stale_m, rel=1e-4, abs=1e-7)
        product = found[0] * found[2]
        assert product - found[1] ** 2 >= -1e-5 * product - 1e-30


@settings(max_examples=50)
@given(st.lists(steps, min_size=1, max_size=6), st.lists(motions, max_size=3))
def test_the_place_is_never_surer_than_possible_in_any_direction(
    taken: list[tuple[list[RelativeMotion], float]], last: list[RelativeMotion]
) -> None:
    """The covariance that is read out is positive semi-definite, also between two frames."""
    cell, ledger = Cell(**OPEN), MotionLedger(with_covariance=True)
    cell.see(Seen(0.0, 1e-3))
    for between, own_m2 in taken:
        for motion in between:
            ledger.add(motion)
        cell.see(Seen(0.0, own_m2), ledger.motions)
    for motion in last:
        ledger.add(motion)
    rover = Rover(0.3, -0.2, ledger.motions, RELATIVE)
    found = place_errors(cell.layers, CELL_M[:1], CELL_M[1:2], rover)
    xx, xy, yy = (float(part[0, 0]) for part in (found.xx_m2, found.xy_m2, found.yy_m2))
    assert np.linalg.eigvalsh([[xx, xy], [xy, yy]])[0] >= -1e-15 * (xx + yy)
    assert found.height_m2[0, 0] >= 0.0


@given(st.lists(st.floats(0.0, 0.1), min_size=1, max_size=5), st.floats(-5.0, 5.0))
def test_a_yaw_error_moves_no_height(yaw_rad2: list[float], place: float) -> None:
    cell, ledger = Cell(**OPEN), MotionLedger(with_covariance=True)
    still = Cell(**OPEN)
    for variance in yaw_rad2:
        sideways = np.diag([variance, variance, 0.0, variance])
        ledger.add(RelativeMotion(0, np.array([place, -place, 1.0]), 0.3, sideways, 0.0))
        cell.see(Seen(0.1, 1e-4), ledger.motions)
        still.see(Seen(0.1, 1e-4))
    assert cell.elevation_m == still.elevation_m
    assert cell.variance_m2 == still.variance_m2


def test_motions_without_error_change_no_bit() -> None:
    ledger = MotionLedger(with_covariance=True)
    moved, still = Cell(), Cell()
    for n in range(5):
        ledger.add(RelativeMotion(n, np.array([0.1 * n, 0.0, 0.0]), 0.2, np.zeros((4, 4)), 0.1))
        moved.see(Seen(0.001 * n, 1e-4, t_ns=n), ledger.motions)
        still.see(Seen(0.001 * n, 1e-4, t_ns=n))
    for name, layer in still.layers._asdict().items():
        if name not in ("motion", "stale_m"):
            np.testing.assert_array_equal(getattr(moved.layers, name), layer, err_msg=name)
    assert moved.motion == 5


def test_a_cell_that_takes_over_starts_anew() -> None:
    ledger = MotionLedger(with_covariance=True)
    cell = Cell()
    for height in (0.0, 0.0, 0.5, 0.5, 0.5):
        ledger.add(RelativeMotion(0, np.zeros(3), 0.0, 1e-6 * np.eye(4), 0.1))
        cell.see(Seen(height, 1e-6), ledger.motions)
    assert cell.elevation_m == pytest.approx(0.5)
    assert (cell.motion, cell.stale_m, cell.horizontal_xx_m2) == (5, 0.0, 0.0)


def test_a_rejected_measurement_leaves_the_cell_to_learn_later() -> None:
    ledger = MotionLedger(with_covariance=True)
    cell = Cell()
    cell.see(Seen(0.0, 1e-6), ledger.motions)
    ledger.add(RelativeMotion(0, np.zeros(3), 0.0, 1e-6 * np.eye(4), 0.1))
    assert cell.see(Seen(0.5, 1e-6), ledger.motions).rejected == 1
    assert (cell.motion, cell.stale_m) == (0, 0.0)


@pytest.mark.parametrize("share", [0.99, 1.01])
def test_the_gate_knows_of_frames_and_drift(share: float) -> None:
    """V_frame of the measurement, V_frame (1 + D / 1 m) of the map, 1 m away; D = 3 m."""
    frames = {"frame_m2": 1e-6, "frame_rad2": 2e-6, "drift_per_m": 1.0}
    ledger = MotionLedger(with_covariance=False)
    cell = Cell()
    cell.see(Seen(0.0, 1e-8))
    ledger.add(RelativeMotion(0, np.zeros(3), 0.0, np.zeros((4, 4)), 3.0))
    height = share * 3.5 * math.sqrt(2e-8 + 3e-6 * (2.0 + 3.0))
    assert cell.see(Seen(height, 1e-8), ledger.motions, **frames).rejected == (share > 1.0)
