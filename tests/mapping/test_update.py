"""The per-cell update: Kalman algebra, gate, second hypothesis, bounds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from mapping.cells.cell_layers import empty_layers
from mapping.cells.update_constants import fusion_constants
from mapping.cells.update_kernels import fuse
from mapping.motion.ledger import at_rest
from mapping.noise import independent_readings
from mapping.settings import MapSettings
from tests.mapping.cells import SECOND_NS, Cell, Seen, constants, sums_of

OPEN_GATE = {"gate_sigma": 1e6}

variances = st.floats(1e-6, 1e-2)
heights = st.floats(-0.5, 0.5)
systematics = st.tuples(*[st.floats(-0.05, 0.05)] * 4)
measurements = st.builds(
    Seen, height_m=heights, own_m2=variances, common_m2=variances, systematic=systematics
)


def _cell_after(*seen: Seen, **settings: float) -> Cell:
    cell = Cell(**settings)
    for item in seen:
        cell.see(item)
    return cell


def test_the_first_measurement_is_taken_as_it_is() -> None:
    cell = _cell_after(Seen(1.25, 3e-4, 1e-4, (0.01, -0.02, 0.03, -0.04), t_ns=77))
    assert cell.elevation_m == pytest.approx(1.25, abs=1e-12)
    assert cell.variance_m2 == pytest.approx(4e-4)
    np.testing.assert_allclose(cell.systematic, [0.01, -0.02, 0.03, -0.04], rtol=1e-6)
    assert (cell.frames, cell.pixels, cell.last_ns, cell.candidate_hits) == (1, 1, 77, 0)


def test_two_measurements_are_fused_as_kalman_says() -> None:
    # V = 4, R = 1 (in 1e-4 m^2): K = 0.8, variance (1 - K) V = 0.8.
    cell = _cell_after(Seen(0.10, 4e-4), Seen(0.11, 1e-4))
    assert cell.elevation_m == pytest.approx(0.108, abs=1e-9)
    assert cell.variance_m2 == pytest.approx(0.8e-4)
    assert cell.frames == 2


@given(st.lists(st.tuples(heights, variances), min_size=1, max_size=12))
def test_independent_measurements_end_as_their_weighted_mean(
    seen: list[tuple[float, float]],
) -> None:
    cell = _cell_after(*(Seen(h, v) for h, v in seen), **OPEN_GATE)
    weights = np.array([1.0 / v for _, v in seen])
    mean = float(weights @ np.array([h for h, _ in seen]) / weights.sum())
    assert cell.elevation_m == pytest.approx(mean, abs=1e-6)
    assert cell.variance_m2 == pytest.approx(1.0 / weights.sum(), rel=1e-5)


@given(measurements, measurements)
def test_the_gain_makes_the_total_variance_least(first: Seen, second: Seen) -> None:
    """(1 - K)^2 V + K^2 R + |(1 - K) s + K m|^2 against a search over K in [0, K_max].

    K_max = min(1, 2 V / (V + R)): beyond it the independent part would rise.
    """
    cell = _cell_after(first, **OPEN_GATE)
    known, s = cell.variance_m2, cell.systematic
    m = np.asarray(second.systematic)
    measured = second.own_m2 + second.common_m2

    def total(gain: float) -> float:
        mixed = (1.0 - gain) * s + gain * m
        return float((1.0 - gain) ** 2 * known + gain**2 * measured + mixed @ mixed)

    # Far apart in time: the pose's error is fresh.
    cell.see(Seen(1.0, second.own_m2, second.common_m2, second.systematic, t_ns=10 * SECOND_NS))
    most = min(2.0 * known / (known + measured), 1.0)
    best = minimize_scalar(total, bounds=(0.0, most), method="bounded", options={"xatol": 1e-9})
    least = min(float(best.fun), total(0.0), total(most))
    assert cell.total_m2 == pytest.approx(least, rel=2e-5)
    gain = (cell.elevation_m - first.height_m) / (1.0 - first.height_m)
    assert total(gain) == pytest.approx(least, rel=1e-5)


@given(st.lists(st.tuples(measurements, st.floats(0.0, 1.0)), min_size=2, max_size=15))
def test_an_update_never_raises_the_total_variance(seen: list[tuple[Seen, float]]) -> None:
    cell = Cell(**OPEN_GATE)
    t_s = 0.0
    before = math.inf
    for item, pause_s in seen:
        t_s += pause_s
        cell.see(
            Seen(
                item.height_m,
                item.own_m2,
                item.common_m2,
                item.systematic,
                t_ns=round(t_s * SECOND_NS),
            )
        )
        assert cell.total_m2 <= before * (1.0 + 1e-5)
        before = cell.total_m2


def test_the_independent_part_does_not_rise_though_that_would_lower_the_total() -> None:
    """V = 1e-6, R = 1e-4: the total is least at K = 0.49, and K is held to 2 / 101."""
    cell = _cell_after(
        Seen(0.0, 1e-6, systematic=(0.03, 0.0, 0.0, 0.0)),
        Seen(0.01, 1e-4, systematic=(-0.03, 0.0, 0.0, 0.0)),
        **OPEN_GATE,
    )
    assert cell.elevation_m == pytest.approx(0.01 * 2.0 / 101.0, rel=1e-6)
    assert cell.variance_m2 == np.float32(1e-6)
    assert cell.systematic[0] == pytest.approx(0.03 - 0.06 * 2.0 / 101.0, rel=1e-6)


def test_views_from_opposite_sides_cancel_a_crooked_mount() -> None:
    # 20 mm too high from one side, 20 mm too low from the other.
    cell = _cell_after(
        Seen(0.02, 1e-6, systematic=(0.02, 0.0, 0.0, 0.0)),
        Seen(-0.02, 1e-6, systematic=(-0.02, 0.0, 0.0, 0.0)),
        **OPEN_GATE,
    )
    assert cell.elevation_m == pytest.approx(0.0, abs=1e-6)
    assert abs(cell.systematic[0]) < 1e-6


def test_a_constant_error_is_not_averaged_away_and_the_nearer_view_counts_more() -> None:
    same = Seen(0.0, 1e-4, systematic=(0.0, 0.0, 0.0, 0.01))
    cell = _cell_after(*[same] * 50)
    assert cell.systematic[3] == pytest.approx(0.01, rel=1e-5)
    assert cell.variance_m2 == pytest.approx(1e-4 / 50, rel=1e-4)
    near = Seen(0.0, 1e-4, systematic=(0.0, 0.0, 0.0, 0.002))
    both = _cell_after(Seen(0.03, 1e-4, systematic=(0.0, 0.0, 0.0, 0.02)), near, **OPEN_GATE)
    assert both.elevation_m < 0.5 * 0.03 * 0.5


@pytest.mark.parametrize(
    ("pause_s", "factor"), [(0.1, 6.0), (0.3, 2.0), (0.6, 1.0), (5.0, 1.0), (0.01, 60.0)]
)
def test_a_common_error_seen_again_soon_is_hardly_new(pause_s: float, factor: float) -> None:
    """R * 2 tau / dt with tau = 0.3 s, and never less than R."""
    first = Seen(0.0, 1e-6, common_m2=1e-4)
    again = Seen(0.0, 1e-6, common_m2=1e-4, t_ns=round(pause_s * SECOND_NS))
    cell = _cell_after(first, again)
    v, r = 1.01e-4, 1e-6 + factor * 1e-4
    assert cell.variance_m2 == pytest.approx(v * r / (v + r), rel=1e-5)


def test_a_common_error_seen_at_the_same_instant_is_not_new_at_all() -> None:
    first = Seen(0.0, 1e-6, common_m2=1e-4)
    for t_ns in (0, -SECOND_NS):  # repeated, and out of order
        cell = _cell_after(first, Seen(0.02, 1e-6, common_m2=1e-4, t_ns=t_ns))
        assert cell.variance_m2 == pytest.approx(1.01e-4, rel=1e-5)
        assert cell.elevation_m == pytest.approx(0.0, abs=1e-6)


def test_correlation_over_no_time_means_fresh_errors() -> None:
    first = Seen(0.0, 1e-6, common_m2=1e-4)
    cell = _cell_after(first, Seen(0.0, 1e-6, common_m2=1e-4), common_correlation_time_s=0.0)
    assert cell.variance_m2 == pytest.approx(1.01e-4 / 2, rel=1e-5)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("share", [0.99, 1.01])
def test_the_gate_is_on_the_variance_of_both_sides(share: float, sign: float) -> None:
    """All in m^2: map, own, common, both constant parts, and the larger relief."""
    known = Seen(0.0, 1e-4, 2e-4, (0.01, 0.0, 0.0, 0.0))
    variance = 3e-4 + 1e-4 + (5e-5 + 2e-5) + 4e-4
    height = sign * share * 3.5 * math.sqrt(variance)
    cell = _cell_after(known)
    counts = cell.see(Seen(height, 5e-5, 2e-5, (0.0, 0.02, 0.0, 0.0), t_ns=SECOND_NS))
    assert counts.rejected == (share > 1.0)
    assert cell.frames == (1 if share > 1.0 else 2)


@pytest.mark.parametrize("share", [0.99, 1.01])
def test_the_gate_is_wider_where_the_ground_is_rough_inside_the_cell(share: float) -> None:
    # Two pixels at +-d: spread 2 d^2, noise 2 * own; relief is the difference.
    own, d = 1e-6, 0.02
    relief = 2.0 * d * d - 2.0 * own
    first = Seen(0.0, own, offsets_m=(-d, d))
    own_first = own + relief / 2.0
    variance = own_first + own_first + relief
    cell = _cell_after(first)
    assert cell.relief_m2 == pytest.approx(relief, rel=1e-5)
    height = share * 3.5 * math.sqrt(variance)
    assert cell.see(Seen(height, own, offsets_m=(-d, d))).rejected == (share > 1.0)


def test_relief_is_the_mean_over_all_degrees_of_freedom() -> None:
    """n - 1 of each frame, so that one frame of many pixels counts more than many of two."""
    frames = [(-0.01, 0.01), (-0.02, 0.0, 0.0, 0.02), (-0.015, 0.015), (0.0,)]
    own = 1e-5
    cell = _cell_after(*(Seen(0.0, own, offsets_m=f) for f in frames), **OPEN_GATE)
    freedom = [len(f) - 1 for f in frames]
    relief = [float(np.var(f, ddof=1)) - len(f) * own if len(f) > 1 else 0.0 for f in frames]
    assert cell.relief_m2 == pytest.approx(np.average(relief, weights=freedom), rel=1e-5)


def test_pixels_share_their_noise_over_the_correlation_area() -> None:
    fusion = fusion_constants(MapSettings(sigma_floor_m=1e-6))
    for area in (1.0, 4.0, 12.0, 50.0):
        variance = 4e-4 / float(independent_readings(np.array(12.0), area))
        layers = empty_layers(1, 1)
        sums = sums_of([1.0] * 12, 1.0 / 4e-4)
        fuse(sums, constants(correlation_area_px=area), fusion, layers, at_rest())
        assert layers.variance_m2[0, 0] == pytest.approx(variance, rel=1e-6)


def test_variance_stays_between_floor_and_ceiling() -> None:
    bounds = {"sigma_floor_m": 0.001, "sigma_ceiling_m": 0.5}
    low = _cell_after(*[Seen(0.0, 1e-10)] * 10, **bounds)
    assert low.variance_m2 == np.float32(1e-6)
    high = _cell_after(Seen(0.0, 90.0), **bounds)
    assert high.variance_m2 == np.float32(0.25)
    swapped = _cell_after(*[Seen(0.0, 1e-6)] * 5, *[Seen(0.9, 1e-10)] * 3, **bounds)
    assert swapped.elevation_m == pytest.approx(0.9)
    assert swapped.variance_m2 == np.float32(1e-6)


def test_pixels_stop_counting_at_their_largest_number() -> None:
    cell = _cell_after(Seen(0.0, 1e-4))
    cell.layers.pixels[0, 0] = 2**32 - 3
    cell.see(Seen(0.0, 1e-4, offsets_m=(-0.01, 0.0, 0.0, 0.01)))
    assert cell.pixels == 2**32 - 1
    cell.see(Seen(0.0, 1e-4))
    assert cell.pixels == 2**32 - 1
    assert math.isfinite(cell.relief_m2)


@given(
    st.lists(
        st.builds(
            Seen,
            height_m=st.floats(-1e4, 1e4),
            own_m2=st.floats(1e-10, 1e12),
            common_m2=st.floats(0.0, 1e12),
            systematic=st.tuples(*[st.floats(-1e3, 1e3)] * 4),
            offsets_m=st.lists(st.floats(-0.04, 0.04), min_size=1, max_size=4),
            t_ns=st.integers(0, 2**62),
        ),
        min_size=1,
        max_size=10,
    )
)
def test_whatever_is_finite_stays_finite(seen: list[Seen]) -> None:
    cell = Cell(sigma_floor_m=0.0002, sigma_ceiling_m=1.0)
    for item in seen:
        cell.see(item)
        numbers = [float(layer[0, 0]) for layer in cell.layers]
        assert all(map(math.isfinite, numbers))
        assert np.float32(0.0002**2) <= cell.variance_m2 <= 1.0


def test_each_cell_of_a_frame_is_on_its_own_and_the_window_wraps_around() -> None:
    """3 x 2 cells at the corner (row 4, column 3) of 5 x 4 layers; one cell saw nothing."""
    layers = empty_layers(5, 4)
    heights = np.array([[0.1, 0.2, 0.3], [0.4, np.nan, 0.6]])
    sums = np.zeros((6, 4))
    for k, height in enumerate(heights.ravel()):
        if np.isfinite(height):
            sums[k] = sums_of([height], 1e4)
    frame = constants(first_column=3, first_row=4, cells_x=3, cells_y=2, t_ns=5)
    counts = fuse(sums, frame, fusion_constants(MapSettings()), layers, at_rest())
    assert counts == (5, 0, 0)
    assert not sums.any()
    expected = np.zeros((5, 4))
    expected[4, [3, 0, 1]] = heights[0]
    expected[0, [3, 1]] = heights[1, [0, 2]]
    np.testing.assert_allclose(layers.elevation_m, expected)
    np.testing.assert_array_equal(layers.frames > 0, expected > 0.0)
