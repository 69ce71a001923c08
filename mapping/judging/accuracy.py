"""How far heights are from the truth, and whether their variance says so: one set of numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

Float64Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Json = dict[str, object]

# 1 / (the 75 % quantile of the unit normal): scales a median of deviations to a sigma.
MAD_TO_SIGMA = 1.4826
# Upper ends of the classes of sigma, in millimetres; the last class has none.
SIGMA_CLASSES_MM = (2.0, 5.0, 10.0, 15.0, 30.0)


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Errors e = height - truth of a set of cells, and the standard deviations claimed for them.

    Numbers of an empty set are NaN.

    Attributes:
        cells: how many cells.
        rmse_m: root mean square of e.
        nmad_m: 1.4826 * median(|e - median(e)|).
        le90_m, p99_m, max_m: 90 % and 99 % quantile and largest value of |e|.
        bias_m: mean of e.
        coverage_1sigma, coverage_2sigma, coverage_3sigma: share of cells with |e| <= k sigma;
            68.3 %, 95.4 % and 99.7 % for exact normal errors.
        anees: mean of (e / sigma)^2; 1 for an honest sigma, above 1 for an overconfident one.
    """

    cells: int
    rmse_m: float
    nmad_m: float
    le90_m: float
    p99_m: float
    max_m: float
    bias_m: float
    coverage_1sigma: float
    coverage_2sigma: float
    coverage_3sigma: float
    anees: float

    def as_json(self) -> Json:
        """Return the numbers by name; those that are not finite as None."""
        return {name: finite_or_none(value) for name, value in asdict(self).items()}


def accuracy(error_m: Float64Array, sigma_m: Float64Array) -> Accuracy:
    """Return the numbers for errors and claimed standard deviations of equal shape (n,)."""
    if error_m.size == 0:
        return Accuracy(0, *[math.nan] * 10)
    size = np.abs(error_m)
    le90, p99 = np.quantile(size, (0.9, 0.99))
    return Accuracy(
        cells=int(error_m.size),
        rmse_m=float(np.sqrt(np.mean(error_m**2))),
        nmad_m=mad_sigma(error_m),
        le90_m=float(le90),
        p99_m=float(p99),
        max_m=float(size.max()),
        bias_m=float(error_m.mean()),
        coverage_1sigma=coverage(error_m, sigma_m, 1),
        coverage_2sigma=coverage(error_m, sigma_m, 2),
        coverage_3sigma=coverage(error_m, sigma_m, 3),
        anees=anees(error_m, sigma_m),
    )


def mad_sigma(values: Float64Array) -> float:
    """Return 1.4826 * median(|v - median(v)|): a sigma that outliers do not move."""
    return float(MAD_TO_SIGMA * np.median(np.abs(values - np.median(values))))


def coverage(error_m: Float64Array, sigma_m: Float64Array, factor: float) -> float:
    """Return the share of errors within `factor` standard deviations."""
    return float(np.mean(np.abs(error_m) <= factor * sigma_m))


def anees(error_m: Float64Array, sigma_m: Float64Array) -> float:
    """Return the mean of (e / sigma)^2; infinite where an error is claimed to be impossible."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(error_m == 0.0, 0.0, error_m / sigma_m)
    return float(np.mean(ratio**2))


def sigma_classes(sigma_m: Float64Array) -> dict[str, BoolArray]:
    """Return which cells belong to each class of claimed sigma, best class first."""
    return classes(1000.0 * sigma_m, SIGMA_CLASSES_MM, "mm")


def classes(values: Float64Array, ends: tuple[float, ...], unit: str) -> dict[str, BoolArray]:
    """Return name -> mask of the classes that end (exclusively) at `ends`; NaN is in none."""
    named = {}
    low = 0.0
    for end in ends:
        named[f"{low:g}-{end:g} {unit}"] = (values >= low) & (values < end)
        low = end
    named[f">={low:g} {unit}"] = values >= low
    return named


def finite_or_none(value: float) -> float | None:
    """Return a number as JSON can hold it."""
    return value if math.isfinite(value) else None


def table(rows: Mapping[str, Accuracy]) -> list[str]:
    """Return a heading and one line per set of cells, in millimetres and per cent."""
    heading = (
        f"{'':<16}{'cells':>9}{'RMSE':>8}{'NMAD':>8}{'LE90':>8}{'P99':>8}{'max':>8}{'bias':>8}"
        f"{'1 sig':>8}{'2 sig':>8}{'3 sig':>8}{'ANEES':>9}"
    )
    units = f"{'':<25}" + f"{'mm':>8}" * 6 + f"{'%':>8}" * 3
    return [heading, units, *(_line(name, row) for name, row in rows.items())]


def _line(name: str, row: Accuracy) -> str:
    if row.cells == 0:
        return f"{name:<16}{0:>9}"
    lengths_m = (row.rmse_m, row.nmad_m, row.le90_m, row.p99_m, row.max_m, row.bias_m)
    shares = (row.coverage_1sigma, row.coverage_2sigma, row.coverage_3sigma)
    return (
        f"{name:<16}{row.cells:>9}"
        + "".join(f"{1000.0 * length:>8.2f}" for length in lengths_m)
        + "".join(f"{100.0 * share:>8.1f}" for share in shares)
        + f"{row.anees:>9.2f}"
    )
