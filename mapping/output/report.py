"""The report of a run: one HTML file that needs no other file and no network."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mapping.cells.elevation_map import CellState, ElevationMap
from mapping.errors import MappingError
from mapping.files import read_whole, write_whole
from mapping.judging.accuracy import Accuracy
from mapping.judging.evaluation import CONFIRMED, Scores
from mapping.output.pages import Picture, picture, render

# An honest sigma covers 68 % and 99.7 %. One error common to a whole run spreads the first from
# run to run, and terrain is not exactly normal, hence these aims.
COVERAGE_1SIGMA_AIM = (0.60, 0.80)
COVERAGE_3SIGMA_AIM = 0.985

_PNG = b"\x89PNG\r\n\x1a\n"
_CAPTIONS = {
    "height": "Heights of the confirmed cells, seen from above.",
    "sigma": "How well each height is known: one standard deviation, logarithmic colours.",
    "state": "Unconfirmed cells were seen too seldom to be trusted.",
    "fused": "What the errors of a cell's place add: most on slopes and beside steps.",
    "layers": "How steep the ground is, and how well it can be driven on.",
    "profile": "A vertical cut: the true terrain should stay inside the band.",
    "surface": "The map between its bounds of 3 standard deviations.",
    "error": "Map minus truth: what is left should look like noise, not like terrain.",
    "scores": "Steep ground and far ground are known less well, and the map should know it.",
    "consistency": "Errors in units of their own sigma: an honest map follows the curve.",
}
# Endings of names, the longer ones before those that they end in.
_UNITS = {
    "_m_sqrt_m": "m √m",
    "_per_m": "1/m",
    "_m2": "m²",
    "_m": "m",
    "_ns": "ns",
    "_s": "s",
    "_rad": "rad",
    "_deg": "deg",
    "_mb": "MB",
    "_px": "px",
    "_hz": "Hz",
    "_sigma": "sigma",
}


def write_report(
    path: Path,
    title: str,
    map_: ElevationMap,
    figures: list[Path],
    scores: Scores | None,
    run: Mapping[str, str],
) -> None:
    """Write the report of a map as one HTML file.

    Args:
        path: the file.
        title: its title.
        map_: the map.
        figures: PNG files, shown in this order; those of `write_figures` get a caption.
        scores: the comparison with a truth, if there is one.
        run: facts about the run under the names to print: frames, messages, seconds, warnings.

    Raises:
        MappingError: a figure cannot be read or is no PNG file, or the file cannot be written.
    """
    page = render(
        "mapping.output",
        "report.html",
        title=title,
        verdict=verdict(map_, scores),
        pictures=[_picture(figure) for figure in figures],
        scores=_score_groups(scores) if scores else {},
        run=run,
        made=[_with_unit(name, value) for name, value in map_.attributes.items()],
        sha256=map_.sha256(),
    )
    write_whole(path, page.encode("utf-8"))


def verdict(map_: ElevationMap, scores: Scores | None) -> list[str]:
    """Return what the run came to in plain sentences."""
    is_confirmed = np.isin(map_.state, CONFIRMED)
    cells = np.count_nonzero(is_confirmed)
    measured = np.count_nonzero(map_.state == CellState.MEASURED)
    area = (
        f"{cells} cells of {100 * map_.resolution_m:g} cm ({cells * map_.resolution_m**2:.2f} m²)"
    )
    sentences = [f"{area} are confirmed; {measured} of them are known well."]
    if cells:
        sigma_mm = 1000.0 * np.median(map_.sigma_m[is_confirmed])
        sentences.append(f"Half of the confirmed cells claim a sigma below {sigma_mm:.1f} mm.")
    if scores is None:
        return [*sentences, "No truth was given, so neither heights nor sigma are judged here."]
    return sentences + _judgement(scores)


def _judgement(scores: Scores) -> list[str]:
    low, high = COVERAGE_1SIGMA_AIM
    one, three = scores.coverage_1sigma, scores.coverage_3sigma
    rmse = f"{1000 * scores.rmse_m:.1f} mm RMSE from the truth"
    p99 = f"99 % of them are within {1000 * scores.p99_m:.1f} mm"
    aim_one = f"aim {100 * low:.0f} to {100 * high:.0f} %: {_met(low <= one <= high)}"
    aim_three = f"aim at least {100 * COVERAGE_3SIGMA_AIM:.1f} %"
    aim_three += f": {_met(three >= COVERAGE_3SIGMA_AIM)}"
    return [
        f"Away from edges the heights are {rmse}; {p99}.",
        f"{100 * one:.1f} % of the errors are within 1 sigma ({aim_one}).",
        f"{100 * three:.2f} % of the errors are within 3 sigma ({aim_three}).",
        f"{100 * scores.completeness:.1f} % of the terrain that counts as visible is mapped.",
    ]


def _met(is_met: bool) -> str:
    return "met" if is_met else "not met"


def _score_groups(scores: Scores) -> dict[str, dict[str, Accuracy]]:
    """Return heading -> rows of the score table, without empty rows."""
    rows = scores.rows()
    groups = {
        "All confirmed cells away from edges": {"all": rows["all"]},
        "By slope of the true terrain": scores.by_slope,
        "By range: horizontal distance from the rover when last seen": scores.by_range,
        "By claimed sigma": scores.by_sigma,
        "Relative to the rover's true pose, within 3 m of it": scores.relative_rows(),
        "Apart": {"edges": scores.edges, "unconfirmed": scores.unconfirmed},
    }
    return {
        heading: {name: row for name, row in group.items() if row.cells}
        for heading, group in groups.items()
    }


def _picture(path: Path) -> Picture:
    content = read_whole(path)
    if not content.startswith(_PNG):
        raise MappingError(f"{path} is not a PNG file; give figures made by write_figures")
    return picture(path.stem, _CAPTIONS.get(path.stem, path.stem), content)


def _with_unit(name: str, value: str | float) -> tuple[str, str]:
    """Return the name in words, and the value with the unit that the name ends in."""
    ending = next((end for end in _UNITS if name.endswith(end)), None)
    if ending is None or isinstance(value, str):
        return name.replace("_", " "), str(value)
    number = f"{value:g}" if isinstance(value, float) else str(value)
    return name.removesuffix(ending).replace("_", " "), f"{number} {_UNITS[ending]}"
