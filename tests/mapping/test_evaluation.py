"""Scores against the truth: numbers worked out by hand, and laws that must hold."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.cells.elevation_map import CellState
from mapping.errors import MappingError
from mapping.judging.accuracy import accuracy
from mapping.judging.evaluation import edge_cells, evaluate, slope_rad
from tests.mapping.maps import hilly_map, make_map

# Nine errors in millimetres; sum -6, sum of squares 144, median 0.
ERRORS_MM = np.array([[0.0, 1.0, -1.0], [2.0, -2.0, 3.0], [-3.0, 4.0, -10.0]])


def test_golden_numbers_of_nine_cells() -> None:
    scores = evaluate(make_map(ERRORS_MM / 1000.0, sigma_m=0.0021), np.zeros((3, 3)))
    assert scores.cells == 9
    expected_mm = {
        "rmse_m": 4.0,  # sqrt(144 / 9)
        "nmad_m": 1.4826 * 2.0,
        "le90_m": 5.2,  # 4 + 0.2 * (10 - 4): place 0.9 * 8 = 7.2 among the sorted sizes
        "p99_m": 9.52,  # place 7.92
        "max_m": 10.0,
        "bias_m": -6.0 / 9.0,
    }
    for name, value_mm in expected_mm.items():
        assert getattr(scores, name) == pytest.approx(value_mm / 1000.0, rel=1e-5), name
    assert scores.coverage_1sigma == pytest.approx(5 / 9)
    assert scores.coverage_2sigma == pytest.approx(8 / 9)
    assert scores.coverage_3sigma == pytest.approx(8 / 9)
    assert scores.anees == pytest.approx(16.0 / 2.1**2, rel=1e-5)
    assert scores.completeness == 1.0


def test_json_has_the_promised_keys_and_is_plain() -> None:
    found = evaluate(make_map(ERRORS_MM / 1000.0), np.zeros((3, 3))).as_json()
    assert list(found) == [
        *("cells", "rmse_m", "nmad_m", "le90_m", "p99_m", "max_m", "bias_m"),
        *("coverage_1sigma", "coverage_2sigma", "coverage_3sigma", "anees"),
        *("by_slope", "by_range", "edges"),
        *("completeness", "by_sigma", "unconfirmed", "relative"),
    ]
    text = json.dumps(found, allow_nan=False)
    assert json.loads(text)["edges"] == {
        name: 0 if name == "cells" else None for name in list(found)[:11]
    }


def test_lines_hold_every_class() -> None:
    lines = evaluate(hilly_map(), np.zeros((30, 40))).describe()
    assert lines[0].split()[:3] == ["cells", "RMSE", "NMAD"]
    assert any(line.startswith("slope 0-5 deg") for line in lines)
    assert any(line.startswith("sigma >=30 mm") for line in lines)
    assert lines[-1].startswith("completeness ")


def test_unknown_unconfirmed_and_truthless_cells_are_apart() -> None:
    heights = [[0.001, 0.5, np.nan, 0.001, 0.7]]
    state = [[CellState.MEASURED, CellState.UNCONFIRMED, 0, CellState.UNCERTAIN, 2]]
    truth = np.array([[0.0, 0.0, 0.0, 0.0, np.nan]])
    scores = evaluate(make_map(heights, state=state), truth)
    assert scores.cells == 2
    assert scores.rmse_m == pytest.approx(0.001)
    assert scores.unconfirmed.cells == 1
    assert scores.unconfirmed.max_m == pytest.approx(0.5)
    assert scores.completeness == pytest.approx(2 / 4)


def test_completeness_counts_visible_cells_inside_and_outside_the_map() -> None:
    heights = [[0.0, 0.0, np.nan, np.nan]]
    visible = np.array([[True, False, True, False]])
    truth = np.zeros((1, 4))
    assert evaluate(make_map(heights), truth, visible).completeness == pytest.approx(1 / 2)
    assert evaluate(
        make_map(heights), truth, visible, visible_outside=2.0
    ).completeness == pytest.approx(1 / 4)
    assert math.isnan(evaluate(make_map(heights), truth, visible & False).completeness)


def test_states_can_be_chosen() -> None:
    state = [[CellState.MEASURED, CellState.UNCERTAIN]]
    scores = evaluate(
        make_map([[0.0, 0.1]], state=state), np.zeros((1, 2)), states=(CellState.MEASURED,)
    )
    assert (scores.cells, scores.max_m) == (1, 0.0)


def test_edges_are_apart() -> None:
    truth = np.zeros((3, 4))
    truth[:, 2:] = 0.1
    heights = truth.copy()
    heights[:, 1] += 0.09
    scores = evaluate(make_map(heights), truth)
    assert scores.cells == 6
    assert scores.max_m < 1e-6
    assert scores.edges.cells == 6
    assert scores.edges.max_m == pytest.approx(0.09, rel=1e-5)
    assert evaluate(make_map(heights), truth, edge_step_m=0.2).edges.cells == 0


def test_an_edge_is_a_step_to_one_of_four_neighbours() -> None:
    truth = np.array([[0.0, 0.0, 0.0], [0.0, 0.06, 0.0], [np.nan, 0.0, 0.0]])
    expected = [[0, 1, 0], [1, 1, 1], [0, 1, 0]]
    np.testing.assert_array_equal(edge_cells(truth, 0.05), np.array(expected, bool))


def test_slope_of_a_plane_is_its_angle_and_survives_gaps() -> None:
    y, x = np.mgrid[0:5, 0:6] * 0.04
    truth = math.tan(math.radians(20.0)) * (0.6 * x + 0.8 * y)
    truth[2, 3] = np.nan
    slope_deg = np.degrees(slope_rad(truth, 0.04))
    np.testing.assert_allclose(slope_deg[np.isfinite(truth)], 20.0, atol=1e-9)
    assert np.isnan(slope_rad(np.array([[0.0, np.nan]]), 0.04)).all()


def test_cells_are_sorted_by_slope_and_by_sigma() -> None:
    x = np.arange(8) * 0.04
    truth = np.tile(np.tan(np.radians(12.0)) * x, (2, 1))
    sigma = np.tile([0.001, 0.003, 0.003, 0.007, 0.012, 0.02, 0.05, 0.05], (2, 1))
    scores = evaluate(make_map(truth, sigma), truth)
    assert [part.cells for part in scores.by_slope.values()] == [0, 0, 16, 0, 0]
    assert [part.cells for part in scores.by_sigma.values()] == [2, 4, 2, 2, 2, 4]


def test_no_overlap_and_wrong_shapes_are_refused() -> None:
    map_ = make_map(np.zeros((2, 2)))
    with pytest.raises(MappingError, match="no confirmed cell"):
        evaluate(map_, np.full((2, 2), np.nan))
    with pytest.raises(MappingError, match=r"truth has shape \(3, 2\) and the map \(2, 2\)"):
        evaluate(map_, np.zeros((3, 2)))
    with pytest.raises(MappingError, match="visible mask has shape"):
        evaluate(map_, np.zeros((2, 2)), np.ones((1, 2), bool))


def test_infinite_truth_is_no_truth() -> None:
    scores = evaluate(make_map(np.zeros((1, 3))), np.array([[0.0, np.inf, np.inf]]))
    assert scores.cells == 1


def test_an_impossible_error_makes_the_consistency_infinite_not_the_json() -> None:
    scores = evaluate(make_map([[0.0, 0.1]], sigma_m=0.0), np.zeros((1, 2)), edge_step_m=1.0)
    assert scores.anees == math.inf
    assert scores.coverage_3sigma == 0.5
    assert scores.as_json()["anees"] is None


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(1e-4, 1.0))
def test_exact_normal_errors_are_covered_as_the_normal_law_says(seed: int, scale: float) -> None:
    random = np.random.default_rng(seed)
    sigma = scale * random.uniform(0.2, 3.0, 40_000)
    found = accuracy(sigma * random.standard_normal(40_000), sigma)
    # Six standard errors of a share (at most 0.0023) and of a mean of squares (0.0071).
    assert found.coverage_1sigma == pytest.approx(0.6827, abs=0.014)
    assert found.coverage_2sigma == pytest.approx(0.9545, abs=0.007)
    assert found.coverage_3sigma == pytest.approx(0.9973, abs=0.0017)
    assert found.anees == pytest.approx(1.0, abs=0.043)


@settings(max_examples=50, deadline=None)
@given(errors=st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=60), seed=st.integers(0, 1000))
def test_the_order_of_cells_does_not_matter(errors: list[float], seed: int) -> None:
    error = np.array(errors)
    sigma = 0.01 + np.abs(np.roll(error, 1))
    order = np.random.default_rng(seed).permutation(error.size)
    straight = accuracy(error, sigma).as_json()
    for name, value in accuracy(error[order], sigma[order]).as_json().items():
        assert value == pytest.approx(straight[name], rel=1e-9, abs=1e-12), name


@settings(max_examples=50, deadline=None)
@given(errors=st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=60))
def test_numbers_keep_their_order(errors: list[float]) -> None:
    found = accuracy(np.array(errors), np.full(len(errors), 0.1))
    assert abs(found.bias_m) <= found.rmse_m + 1e-15
    assert found.rmse_m <= found.max_m + 1e-15
    assert found.le90_m <= found.p99_m <= found.max_m
    assert found.coverage_1sigma <= found.coverage_2sigma <= found.coverage_3sigma


def test_mirroring_map_and_truth_changes_nothing() -> None:
    map_ = hilly_map()
    truth = np.nan_to_num(map_.elevation_m.astype(float)) + 0.003
    straight = evaluate(map_, truth)
    mirrored = make_map(map_.elevation_m[:, ::-1], map_.sigma_m[:, ::-1], map_.state[:, ::-1])
    found = evaluate(mirrored, truth[:, ::-1])
    assert found.edges.cells == straight.edges.cells
    assert found.rmse_m == pytest.approx(straight.rmse_m, rel=1e-9)
    assert [p.cells for p in found.by_slope.values()] == [
        p.cells for p in straight.by_slope.values()
    ]
