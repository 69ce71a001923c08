"""The second hypothesis of a cell: when it wins, and with which height and variance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.mapping.cells import Cell, Seen

GROUND = Seen(0.0, 1e-6)
STONE = Seen(0.3, 1e-6)


def _hits(cell: Cell, seen: Sequence[Seen]) -> list[tuple[int, int]]:
    return [(counts.rejected, counts.replaced) for counts in map(cell.see, seen)]


def _ground() -> Cell:
    """Return a cell that is sure of its height."""
    cell = Cell()
    _hits(cell, [GROUND] * 5)
    return cell


@pytest.mark.parametrize("confirmations", [1, 2, 3, 7, 255])
def test_a_second_hypothesis_wins_after_exactly_so_many_rejects(confirmations: int) -> None:
    cell = Cell(confirmations=confirmations)
    _hits(cell, [GROUND] * 20)
    found = _hits(cell, [STONE] * confirmations)
    assert found == [(1, 0)] * (confirmations - 1) + [(1, 1)]
    assert cell.elevation_m == pytest.approx(0.3, abs=1e-9)
    assert cell.variance_m2 == pytest.approx(1e-6 / confirmations, rel=1e-3)
    assert (cell.frames, cell.pixels, cell.candidate_hits) == (confirmations, confirmations, 0)
    assert cell.see(STONE) == (1, 0, 0)


def test_rejects_that_contradict_each_other_never_win() -> None:
    cell = _ground()
    scattered = [Seen(h, 1e-6) for h in (0.3, -0.2, 0.5, 0.1, -0.4, 0.3, 0.6)]
    assert _hits(cell, scattered) == [(1, 0)] * 7
    assert cell.elevation_m == pytest.approx(0.0, abs=1e-9)
    assert cell.candidate_hits == 1


def test_a_contradiction_starts_the_count_again() -> None:
    cell = _ground()
    other = Seen(-0.3, 1e-6)
    assert _hits(cell, [STONE, STONE, other, STONE, STONE]) == [(1, 0)] * 5
    assert cell.see(STONE).replaced == 1


def test_an_accepted_measurement_in_between_weakens_it() -> None:
    cell = _ground()
    _hits(cell, [STONE, STONE])
    assert cell.candidate_hits == 2
    cell.see(GROUND)
    assert cell.candidate_hits == 1
    assert _hits(cell, [STONE, STONE]) == [(1, 0), (1, 1)]
    other = _ground()
    _hits(other, [STONE, STONE, GROUND, GROUND, GROUND, GROUND])
    assert other.candidate_hits == 0
    assert _hits(other, [STONE, STONE, STONE]) == [(1, 0), (1, 0), (1, 1)]


def test_the_winner_is_the_weighted_mean_of_its_hits() -> None:
    cell = _ground()
    hits = [Seen(0.300, 4e-6), Seen(0.304, 1e-6), Seen(0.301, 2e-6, t_ns=9)]
    _hits(cell, hits)
    weights = np.array([0.25, 1.0, 0.5])
    mean = weights @ np.array([0.300, 0.304, 0.301]) / weights.sum()
    assert cell.elevation_m == pytest.approx(mean, abs=1e-9)
    assert cell.variance_m2 == pytest.approx(1e-6 / weights.sum(), rel=1e-5)
    assert cell.last_ns == 9


def test_the_winner_keeps_the_whole_error_of_the_pose() -> None:
    """Three hits within 0.1 s share it; fused as fresh it would count as a third."""
    hits = [Seen(0.3, 3e-6, common_m2=1e-4, t_ns=n * 30_000_000) for n in range(3)]
    cell = _ground()
    assert _hits(cell, hits)[-1] == (1, 1)
    assert cell.variance_m2 == pytest.approx(1e-6 + 1e-4, rel=1e-5)


def test_hits_that_differ_by_the_error_of_their_poses_agree() -> None:
    hits = [Seen(h, 1e-8, common_m2=1e-4) for h in (0.30, 0.33, 0.30)]
    assert _hits(_ground(), hits)[-1] == (1, 1)
    sharp = [Seen(h, 1e-8) for h in (0.30, 0.33, 0.30)]
    assert _hits(_ground(), sharp)[-1] == (1, 0)


@given(st.lists(st.lists(st.floats(-0.02, 0.02), min_size=1, max_size=6), min_size=1, max_size=8))
def test_relief_stays_within_what_the_frames_said_also_after_a_change(
    later: list[list[float]],
) -> None:
    """A winner has fewer pixels than frames to its name; the share of a frame must not pass 1."""
    own = 1e-7
    cell = _ground()
    _hits(cell, [Seen(0.3, own)] * 3)
    said = [0.0]
    for offsets in later:
        centred = np.array(offsets) - np.mean(offsets)
        seen = Seen(0.3, own, offsets_m=centred.tolist())
        if cell.see(seen).rejected == 0 and len(offsets) > 1:
            said.append(float(np.var(centred, ddof=1)) - len(offsets) * own)
    slack = 1e-9 + 1e-5 * max(map(abs, said))
    assert min(said) - slack <= cell.relief_m2 <= max(said) + slack
