"""What holds of a cell whatever it is shown: it never knows less, and nonsense never spreads."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.samples import PoseSample, frozen_array
from mapping.cells.cell_layers import CellLayers, empty_layers
from mapping.cells.update_constants import fusion_constants
from mapping.cells.update_kernels import fuse
from mapping.errors import MappingError
from mapping.mapper import Mapper
from mapping.measurement_kernels import add_row
from mapping.motion.ledger import MotionLedger, at_rest
from mapping.motion.relative import RelativeMotion
from mapping.noise import NGUYEN_2012
from mapping.settings import MapSettings
from tests.mapping.cells import SECOND_NS, Cell, Seen, constants
from tests.mapping.scenes import floor_frame, mount, pose_sample

# Variances and sensitivities of all orders of magnitude, those of a sensor among them.
variances = st.floats(-10.0, 0.0).map(lambda exponent: 10.0**exponent)
sensitivities = st.one_of(
    st.just(0.0), st.floats(-1.0, 1.0), st.floats(-0.05, 0.05), st.floats(-1e-4, 1e-4)
)
measurements = st.builds(
    Seen,
    height_m=st.floats(-0.5, 0.5) | st.floats(-0.002, 0.002),
    own_m2=variances,
    common_m2=st.just(0.0) | variances,
    systematic=st.tuples(*[sensitivities] * 4),
    offsets_m=st.lists(st.floats(-0.04, 0.04), min_size=1, max_size=4),
)
# Seconds since the last frame, height variance of the motion in between, how often it is shown.
frames = st.tuples(measurements, st.floats(0.0, 1.0), st.just(0.0) | variances, st.integers(1, 4))


@settings(max_examples=150)
@given(st.lists(frames, min_size=2, max_size=8), st.sampled_from([3.5, 1e6]))
def test_an_accepted_frame_never_raises_the_independent_variance(
    taken: list[tuple[Seen, float, float, int]], gate_sigma: float
) -> None:
    """(1 - K)^2 V + K^2 R <= V, whatever the sensitivities; V with what motions have added."""
    cell, ledger = Cell(gate_sigma=gate_sigma), MotionLedger(with_covariance=True)
    t_s = 0.0
    for seen, pause_s, moved_m2, times in taken:
        growth = np.diag([0.0, 0.0, moved_m2, 0.0])
        for _ in range(times):
            t_s += pause_s
            ledger.add(RelativeMotion(0, np.zeros(3), 0.0, growth, 0.0))
            known = ledger.motions.sums[ledger.motions.now, 6] - ledger.motions.sums[cell.motion, 6]
            before = np.float32(cell.variance_m2 + known)
            first = cell.frames == 0
            counts = cell.see(replace(seen, t_ns=round(t_s * SECOND_NS)), ledger.motions)
            if first or counts.rejected:
                continue
            # A sum of motions may be rounded the other way; without it nothing is.
            limit = before if known == 0.0 else np.nextafter(before, np.float32(np.inf))
            assert cell.variance_m2 <= limit
    assert all(math.isfinite(layer[0, 0]) for layer in cell.layers)


def _map_of(order: NDArray[np.intp], readings: NDArray[np.float32]) -> CellLayers:
    """Return 3 x 4 cells that saw readings (height, weight, cell) in that order, four frames."""
    height_m, weight, cell = readings[order].T
    layers, sums = empty_layers(3, 4), np.zeros((12, 4))
    for part in np.array_split(np.arange(order.size), 4):
        mine = np.isin(order, part)
        add_row(
            np.ascontiguousarray(height_m[mine]),
            np.ascontiguousarray(weight[mine]),
            cell[mine].astype(np.int32),
            sums,
        )
        frame = constants(cells_x=4, cells_y=3, camera_z_m=0.7)
        fuse(sums, frame, fusion_constants(MapSettings()), layers, at_rest())
    return layers


@given(st.integers(0, 2**32 - 1))
def test_pixels_in_another_order_make_the_same_map_to_a_micrometre(seed: int) -> None:
    random = np.random.default_rng(seed)
    readings = np.stack(
        [
            random.normal(-0.7, 0.02, 400),
            10.0 ** random.uniform(2.0, 8.0, 400),
            random.integers(-1, 12, 400),
        ],
        axis=1,
    ).astype(np.float32)
    straight = _map_of(np.arange(400), readings)
    permuted = _map_of(random.permutation(400), readings)
    np.testing.assert_allclose(permuted.elevation_m, straight.elevation_m, rtol=0.0, atol=1e-6)
    for name in ("frames", "pixels"):
        np.testing.assert_array_equal(getattr(permuted, name), getattr(straight, name))
    np.testing.assert_allclose(permuted.variance_m2, straight.variance_m2, rtol=1e-4)


nonsense = st.sampled_from([math.nan, math.inf, -math.inf, 1e300, -1e300])


def _broken(pose: PoseSample, name: str, place: int, value: float) -> PoseSample:
    """Return the pose with one of its numbers replaced."""
    array = np.array(getattr(pose, name))
    array.reshape(-1)[place % array.size] = value
    changes: dict[str, Any] = {name: frozen_array(array, array.shape)}
    return replace(pose, **changes)


@settings(max_examples=40)
@given(st.sampled_from(["position_m", "quat_wxyz", "covariance"]), st.integers(0, 35), nonsense)
def test_a_pose_with_a_number_that_is_none_leaves_the_map_as_it_is(
    name: str, place: int, value: float
) -> None:
    mapper = Mapper(MapSettings(resolution_m=0.1), NGUYEN_2012)
    for sample in (mount(), pose_sample(0), floor_frame(0)):
        mapper.add(sample)
    before = mapper.elevation_map().sha256()
    with pytest.raises(MappingError, match="pose at 9 ns"):
        mapper.add(_broken(pose_sample(9), name, place, value))
    mapper.finish()
    map_ = mapper.elevation_map()
    assert map_.sha256() == before
    assert np.isfinite(map_.elevation_m[map_.frames > 0]).all()
