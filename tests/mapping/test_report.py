"""The report: one file, self-contained, safe, in plain words."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from mapping.cells.elevation_map import CellState
from mapping.errors import MappingError
from mapping.judging.evaluation import Scores, evaluate
from mapping.output.figure_plan import state_figure
from mapping.output.figures import png_bytes
from mapping.output.report import verdict, write_report
from tests.mapping.maps import hilly_map, make_map


class _Page(HTMLParser):
    """Collects text, addresses and pictures, and checks that every tag is closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.text, self.addresses, self.open = "", [""], [""]
        self.feed(text)
        assert self.open == [""]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href")]
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def _scores() -> Scores:
    map_ = hilly_map()
    noise = np.random.default_rng(5).standard_normal(map_.state.shape)
    return evaluate(map_, np.where(map_.known, map_.elevation_m + map_.sigma_m * noise, 0.0))


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    path = tmp_path / "state.png"
    path.write_bytes(png_bytes(state_figure(hilly_map())))
    return path


def test_the_report_is_one_file_that_asks_nobody(tmp_path: Path, picture: Path) -> None:
    path = tmp_path / "report.html"
    run = {"frames": "58 of 58 mapped", "warnings": "1 frame without pose"}
    write_report(path, "Cabinet run", hilly_map(), [picture], _scores(), run)
    source = path.read_text(encoding="utf-8")
    page = _Page(source)
    addresses = [address for address in page.addresses if address]
    assert len(addresses) == 1
    kind, data = addresses[0].split(",")
    assert kind == "data:image/png;base64"
    assert base64.b64decode(data) == picture.read_bytes()
    assert not re.search(r"https?:|url\(|@import|<script", source)
    for words in ("Cabinet run", "58 of 58 mapped", "1 frame without pose", hilly_map().sha256()):
        assert words in page.text
    assert "Unconfirmed cells were seen too seldom" in page.text


def test_settings_stand_with_their_units(tmp_path: Path) -> None:
    map_ = hilly_map()
    map_ = replace(map_, attributes={**map_.attributes, "quantum_per_m": 0.003, "input_m": "a"})
    write_report(tmp_path / "r.html", "t", map_, [], None, {})
    facts = dict(
        re.findall(r'<th scope="row">(.*?)</th><td>(.*?)</td>', (tmp_path / "r.html").read_text())
    )
    assert facts["resolution"] == "0.04 m"
    assert facts["memory limit"] == "4096 MB"
    assert facts["gate"] == "3.5 sigma"
    assert facts["mount sigma"] in ("0 m", "0 rad")
    assert facts["quantum"] == "0.003 1/m"
    assert facts["input m"] == "a"
    assert facts["noise model"] == "nguyen2012"
    assert facts["confirmations"] == "3"
    assert facts["confirmed frames"] == "2"


def test_scores_stand_by_slope_and_sigma(tmp_path: Path) -> None:
    scores = _scores()
    write_report(tmp_path / "r.html", "t", hilly_map(), [], scores, {})
    page = _Page((tmp_path / "r.html").read_text())
    for name, part in {**scores.by_slope, **scores.by_sigma}.items():
        assert (name in page.text) == bool(part.cells), name
    assert f"{1000 * scores.rmse_m:.2f}" in page.text


def test_the_verdict_says_what_was_aimed_at_and_whether_it_was_met() -> None:
    map_ = make_map(np.full((10, 10), 0.004), sigma_m=0.005)
    scores = evaluate(map_, np.zeros((10, 10)))
    met = " ".join(verdict(map_, replace(scores, coverage_1sigma=0.7, coverage_3sigma=0.985)))
    assert "4.0 mm RMSE" in met
    assert "70.0 % of the errors are within 1 sigma (aim 60 to 80 %: met)" in met
    assert "98.50 % of the errors are within 3 sigma (aim at least 98.5 %: met)" in met
    missed = " ".join(verdict(map_, replace(scores, coverage_1sigma=0.81, coverage_3sigma=0.98)))
    assert "(aim 60 to 80 %: not met)" in missed
    assert "(aim at least 98.5 %: not met)" in missed


def test_without_a_truth_nothing_is_judged() -> None:
    words = " ".join(verdict(make_map(np.zeros((10, 10)), sigma_m=0.005), None))
    assert "100 cells of 4 cm (0.16 m²) are confirmed" in words
    assert "below 5.0 mm" in words
    assert "No truth was given" in words
    assert "0 cells" in verdict(make_map([[0.0]], state=CellState.UNCONFIRMED), None)[0]


def test_text_from_outside_cannot_become_markup(tmp_path: Path) -> None:
    evil = "<script>alert('x')</script>"
    map_ = replace(hilly_map(), attributes={"input": evil})
    write_report(tmp_path / "r.html", evil, map_, [], None, {evil: evil})
    source = (tmp_path / "r.html").read_text()
    assert "<script" not in source
    assert _Page(source).text.count(evil) == 5  # title twice, name and value, input


def test_a_figure_that_is_missing_or_no_picture_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MappingError, match=r"cannot read .*gone\.png"):
        write_report(tmp_path / "r.html", "t", hilly_map(), [tmp_path / "gone.png"], None, {})
    (tmp_path / "text.png").write_text("no picture")
    with pytest.raises(MappingError, match=r"text\.png is not a PNG file"):
        write_report(tmp_path / "r.html", "t", hilly_map(), [tmp_path / "text.png"], None, {})
    assert not (tmp_path / "r.html").exists()
