"""What a calibration is worth, in plain words."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from math import degrees

import numpy as np

from calibration_rigs.plate_rig.cell_result import CellResult
from calibration_rigs.plate_rig.manifest import CellEntry
from calibration_rigs.plate_rig.process import PlateResult, worst_held_out
from calibration_rigs.plate_rig.products import measured

_GOOD_SHARE = 0.1
# A correct law fails the chi-square of 5 % of the cells; by chance hardly more than this.
_POOR_FIT_SHARE = 0.15
_LEVEL = 0.05
# More cells with the same fault are counted rather than named.
_NAMED = 3


@dataclass(frozen=True, slots=True)
class Comparison:
    """Outdoor against indoor, over cells of the same distance and angle.

    Attributes:
        cells: pairs.
        sigma_ratio: median of sigma outdoor / sigma indoor.
        error_m: median of error outdoor - error indoor.
        fill: median of fill rate outdoor - fill rate indoor.
    """

    cells: int
    sigma_ratio: float
    error_m: float
    fill: float


def compare_environments(cells: list[CellResult]) -> Comparison | None:
    """Return what sunlight does, or None when no cell was recorded in both."""
    indoor, outdoor = (
        {(c.cell.distance_m, c.cell.angle_deg): c for c in cells if c.cell.environment == where}
        for where in ("indoor", "outdoor")
    )
    pairs = [(indoor[key], outdoor[key]) for key in sorted(indoor.keys() & outdoor.keys())]
    if not pairs:
        return None
    errors = [b.error_m - a.error_m for a, b in pairs if a.error_m is not None if b.error_m]
    return Comparison(
        len(pairs),
        float(np.median([b.sigma_m / a.sigma_m for a, b in pairs])),
        float(np.median(errors)) if errors else float("nan"),
        float(np.median([b.fill_rate - a.fill_rate for a, b in pairs])),
    )


def verdict(result: PlateResult) -> list[str]:
    """Return the calibration in a few sentences."""
    used, box, best = result.used, measured(result).validity, result.laws[0]
    share = worst_held_out(result)
    good = "can be used" if share <= _GOOD_SHARE else "should be repeated with more cells"
    below = sum(cell.spread.is_below for cell in used)
    sentences = [
        (
            f"{len(used)} of {len(result.manifest.cells)} cells are used; the model holds from "
            f"{box.range_min_m:.2f} to {box.range_max_m:.2f} m and up to "
            f"{degrees(box.incidence_max_rad):.0f}° of incidence."
        ),
        (
            f"The law {best.name!r} misses a station that it has not seen by {100.0 * share:.1f} % "
            f"of sigma: the calibration {good}."
            if np.isfinite(share)
            else f"Too few stations tell sigma to check the law {best.name!r} on one left out: use "
            "it with care."
        ),
        _bias_sentence(result),
    ]
    if below:
        sentences.append(
            f"In {below} cells the noise is below 0.3 steps: there it is a bound, not a value."
        )
    tested = [cell.goodness.p for cell in used if cell.goodness is not None]
    if tested:
        poor = sum(p < _LEVEL for p in tested)
        fits = "fits" if poor <= max(_POOR_FIT_SHARE * len(tested), 1) else "does not fit"
        sentences.append(
            f"A normal law that was rounded to the sensor's steps {fits} the readings: {poor} of "
            f"{len(tested)} cells fail the chi-square at 5 %."
        )
    return [*sentences, _paper_sentence(used), *_sunlight(used)]


def _bias_sentence(result: PlateResult) -> str:
    ends = np.array([result.bands.z_m[0], result.bands.z_m[-1]])
    bias, sigma = 1000.0 * result.bias.at_m(ends), 1000.0 * result.bias.sigma_m(ends)
    return (
        f"Readings are off by {bias[0]:+.1f} ± {2.0 * sigma[0]:.1f} mm at {ends[0]:.2f} m and by "
        f"{bias[1]:+.1f} ± {2.0 * sigma[1]:.1f} mm at {ends[1]:.2f} m (95 %); the file corrects it."
    )


def _paper_sentence(used: list[CellResult]) -> str:
    farthest = max(used, key=lambda c: (round(c.cell.distance_m, 3), -c.incidence_rad))
    ratio = farthest.plain_sigma_m / farthest.paper.column_sigma_m
    return (
        f"The paper's column estimate at {farthest.z_m:.2f} m is "
        f"{1000.0 * farthest.paper.column_sigma_m:.2f} mm, {ratio:.1f} times less than the spread "
        f"of a pixel: it is the spread of means over {farthest.paper.rows:.0f} rows. It is shown "
        "for comparison and is not in the file."
    )


def _sunlight(used: list[CellResult]) -> list[str]:
    found = compare_environments(used)
    if found is None:
        return []
    error = "" if np.isnan(found.error_m) else f", the error by {1000.0 * found.error_m:+.1f} mm"
    return [
        (
            f"Outdoors, in {found.cells} cells recorded both ways, sigma changes by a factor of "
            f"{found.sigma_ratio:.2f}{error}, the fill rate by {100.0 * found.fill:+.0f} points."
        )
    ]


def cell_warnings(result: PlateResult) -> list[str]:
    """Return what is wrong with single cells, one line each; what many share is said once."""
    places = Counter(cell.name for cell in result.manifest.cells)
    cells_of: dict[str, list[str]] = {}
    for failure in result.failures:
        cells_of.setdefault(failure.reason, []).append(_named(failure.cell, places))
    for cell in result.cells:
        for fault in cell.faults:
            cells_of.setdefault(fault.text, []).append(_named(cell.cell, places))
    return [
        f"{', '.join(names) if len(names) <= _NAMED else f'{len(names)} cells'}: {text}"
        for text, names in cells_of.items()
    ]


def _named(cell: CellEntry, places: Counter[str]) -> str:
    """Return a cell's place, and its recording where several cells are of one place."""
    return cell.name if places[cell.name] == 1 else f"{cell.name} ({cell.recording})"
