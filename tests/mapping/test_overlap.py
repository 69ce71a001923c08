"""A truth of another place is told as one, and scores of a few cells as such."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import cli
from mapping.errors import MappingError
from mapping.judging.overlap import overlap_warning
from mapping.judging.truth import Truth, write_truth
from mapping.output.map_file import write_map
from tests.mapping.maps import make_map

MAP = make_map(np.zeros((20, 20)), resolution_m=0.1, first_x=0, first_y=0)


def _truth(columns: int, shift_m: float = 0.0) -> Truth:
    """Return a flat truth at the map's first columns, or beside them."""
    return Truth(MAP.x_m[:columns] + shift_m, MAP.y_m, np.zeros((20, columns)))


def test_a_truth_of_the_maps_place_needs_no_word() -> None:
    assert overlap_warning(MAP, _truth(20)) == ""
    assert overlap_warning(MAP, _truth(10)) == ""


def test_scores_of_the_lesser_part_or_of_few_cells_are_told() -> None:
    assert overlap_warning(MAP, _truth(9)) == (
        "the scores are of 180 of the map's 400 confirmed cells alone; the truth may be of "
        "another place"
    )
    small = make_map(np.zeros((9, 11)), resolution_m=0.1, first_x=0, first_y=0)
    assert overlap_warning(small, _truth(20)) == (
        "the scores are of 99 of the map's 99 confirmed cells alone"
    )


def test_a_truth_without_a_common_cell_is_refused() -> None:
    with pytest.raises(MappingError) as caught:
        overlap_warning(MAP, _truth(20, shift_m=50.02))
    assert str(caught.value).startswith(
        "the truth is of another place: the map lies at x 0.1 to 2.0, y 0.1 to 2.0 m, the truth at "
        "x 50.1 to 52.0, y 0.1 to 2.0 m, and none of the map's 400 confirmed cells"
    )


def test_the_command_warns_beside_the_scores(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    map_file, truth = tmp_path / "map.nc", tmp_path / "truth.nc"
    write_map(MAP, map_file)
    write_truth(truth, _truth(3))
    assert cli.main(["evaluate", str(map_file), "--truth", str(truth)]) == 0
    told = capsys.readouterr()
    assert "completeness" in told.out
    assert "terravibe: warning: the scores are of 60 of the map's 400 confirmed" in told.err
    write_truth(truth, _truth(3, shift_m=-9.0))
    assert cli.main(["evaluate", str(map_file), "--truth", str(truth)]) == 2
    assert "the truth is of another place" in capsys.readouterr().err
