"""A flat floor with a box: which cells are floor, and what is said of them."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from mapping.cells.elevation_map import CellState, ElevationMap
from mapping.errors import MappingError
from mapping.judging.floor_evaluation import Box, evaluate_floor, read_box
from tests.mapping.maps import make_map

# A quarter turn: its length lies along y.
BOX = Box(1.0, 1.0, 0.25, math.pi / 2.0, 0.5, 0.3, 0.25)


def _room(floor_m: float = 0.003, sigma_m: float = 0.004) -> ElevationMap:
    """Return 2 m x 2 m of floor with the box on it and one thing beside it."""
    centres = (np.arange(50) + 0.5) * 0.04
    x, y = np.meshgrid(centres, centres)
    heights = np.full((50, 50), floor_m)
    heights[(np.abs(x - 1.0) < 0.31) & (np.abs(y - 1.0) < 0.51)] = 0.51
    heights[0, 0] = 0.4
    return make_map(heights, sigma_m, first_x=0, first_y=0)


def test_the_floor_is_what_is_clear_of_the_box_and_near_its_height() -> None:
    scores = evaluate_floor(_room(), 0.0, BOX)
    # Centres within 0.45 m of x = 1 (22 columns) and 0.65 m of y = 1 (32 rows) are not clear.
    assert scores.floor["confirmed"].cells == 50 * 50 - 22 * 32 - 1
    assert scores.not_floor_cells == 1
    assert scores.floor["confirmed"].median_m == pytest.approx(0.003, rel=1e-5)
    assert scores.floor["confirmed"].mad_sigma_m == 0.0
    assert scores.floor["confirmed"].coverage_1sigma == 1.0
    assert scores.floor["confirmed"].anees == pytest.approx((3.0 / 4.0) ** 2, rel=1e-5)
    # Centres within 0.24 m of x = 1 (12 columns) and 0.44 m of y = 1 (22 rows) are top.
    assert scores.box_cells == 12 * 22
    assert scores.box_top_m == pytest.approx(0.51)
    assert scores.box_top_true_m == 0.5


def test_without_a_box_things_on_the_floor_are_counted_apart() -> None:
    scores = evaluate_floor(_room())
    assert scores.not_floor_cells == 16 * 26 + 1  # the box's cells and the one thing
    assert math.isnan(scores.box_top_m)
    assert scores.as_json()["box_top_m"] is None
    json.dumps(scores.as_json(), allow_nan=False)


def test_states_and_sigma_classes_have_rows_of_their_own() -> None:
    state = [[CellState.MEASURED, CellState.UNCERTAIN, CellState.UNCONFIRMED]]
    scores = evaluate_floor(make_map([[0.0, 0.05, 0.09]], [[0.001, 0.02, 0.001]], state))
    cells = {name: part.cells for name, part in scores.floor.items() if part.cells}
    assert cells == {"confirmed": 2, "measured": 1, "sigma 0-2 mm": 1, "sigma 15-30 mm": 1}
    assert scores.floor["confirmed"].coverage_1sigma == 0.5
    assert scores.floor["confirmed"].coverage_3sigma == 1.0
    lines = evaluate_floor(_room(), 0.0, BOX).describe()
    assert lines[2].split()[:4] == ["confirmed", "1795", "3.00", "0.00"]
    assert lines[-1].startswith("box top: median 0.5100 m in 264 cells, true 0.5000 m")


def test_the_floor_around_the_box_is_judged_apart() -> None:
    centres = (np.arange(150) + 0.5) * 0.04 - 2.0
    x, y = np.meshgrid(centres, centres)
    inside = (np.abs(x - 1.0) < 0.8) & (np.abs(y - 1.0) < 1.0)
    map_ = make_map(np.where(inside, 0.002, 0.02), 0.01, first_x=-50, first_y=-50)
    floor = evaluate_floor(map_, 0.0, BOX).floor
    assert floor["around the box"].median_m == pytest.approx(0.002)
    # 40 by 50 cells within 0.5 m of it, less the 22 by 32 that are not clear of it.
    assert floor["around the box"].cells == 40 * 50 - 22 * 32
    assert floor["confirmed"].median_m == pytest.approx(0.02)


def test_a_map_without_floor_is_refused() -> None:
    with pytest.raises(MappingError, match=r"no confirmed cell lies within 0\.1 m of the floor"):
        evaluate_floor(_room(), 5.0)


def test_a_box_is_read_from_its_file(real_data: Path) -> None:
    box = read_box(real_data / "tum_fr3_cabinet" / "box.txt")
    assert box.top_m == pytest.approx(0.554, abs=0.001)
    assert box.half_length_m == 0.396318


@pytest.mark.parametrize(
    "text", ["", "1 2 3", "1 2 3 4 5 6 7 8", "a b c d e f g", "0 0 0 0 1 1 -1", "nan 0 0 0 1 1 1"]
)
def test_a_file_that_is_no_box_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "box.txt").write_text(text)
    with pytest.raises(MappingError, match=r"box\.txt is no box: expected seven numbers"):
        read_box(tmp_path / "box.txt")
