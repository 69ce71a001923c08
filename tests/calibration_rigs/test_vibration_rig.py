"""Sensitivity of a vibration sensor against a reference, and the table it is read from."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from calibration_rigs.errors import RigError
from calibration_rigs.static_rig.vibration import Comparison, read_comparisons, sensitivities

TABLE = "frequency_hz,reference_m_s2,sensor_m_s2\n80,10.0,9.8\n20,5.0,5.1\n80,10.0,9.6\n"


def test_each_frequency_gets_its_ratio_and_interval(tmp_path: Path) -> None:
    path = tmp_path / "shaker.csv"
    path.write_text(TABLE)
    low, high = sensitivities(read_comparisons(path))
    assert (low.frequency_hz, low.repetitions, low.half_width_95) == (20.0, 1, math.inf)
    assert low.ratio == pytest.approx(1.02)
    assert high.ratio == pytest.approx(0.97)
    # Student's t of one degree of freedom, 12.706, times the standard error 0.01.
    assert high.half_width_95 == pytest.approx(12.706 * 0.01, rel=1e-3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n1,2\n", "expected frequency_hz, reference_m_s2, sensor_m_s2"),
        (TABLE + "80,0,1\n", r"shaker\.csv:5: found .*expected three numbers above 0"),
        (TABLE + "80,ten,1\n", r"shaker\.csv:5"),
        (TABLE + "80,1\n", r"shaker\.csv:5"),
        ("", "expected frequency_hz"),
    ],
)
def test_a_faulty_table_is_refused_with_its_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "shaker.csv"
    path.write_text(text)
    with pytest.raises(RigError, match=message):
        read_comparisons(path)


def test_nothing_to_compare_is_refused() -> None:
    with pytest.raises(RigError, match="no reading beside the reference"):
        sensitivities([])
    with pytest.raises(RigError, match="cannot read"):
        read_comparisons(Path("/nonexistent/shaker.csv"))


def test_the_ratio_does_not_depend_on_the_order() -> None:
    rows = [Comparison(80.0, 10.0, 9.8), Comparison(20.0, 5.0, 5.1), Comparison(80.0, 10.0, 9.6)]
    assert sensitivities(rows) == sensitivities(rows[::-1])
