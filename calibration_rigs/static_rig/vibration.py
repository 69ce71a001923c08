"""Sensitivity of a vibration sensor at each frequency of a shaker, against a reference pickup.

Comparison with a reference transducer, as in ISO 16063-21: at each frequency the ratio of what
the sensor says to what the reference says, over repetitions.
"""

from __future__ import annotations

import csv
import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import stats

from calibration_rigs.errors import RigError

_COLUMNS = ("frequency_hz", "reference_m_s2", "sensor_m_s2")


@dataclass(frozen=True, slots=True)
class Comparison:
    """One reading beside the reference; peak accelerations in m/s^2."""

    frequency_hz: float
    reference_m_s2: float
    sensor_m_s2: float


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """Sensor over reference at one frequency.

    Attributes:
        frequency_hz: of the shaker.
        ratio: mean over the repetitions; 1 = the sensor is right.
        half_width_95: half of the 95 % interval of the mean (Student); infinite for one reading.
        repetitions: how many readings.
    """

    frequency_hz: float
    ratio: float
    half_width_95: float
    repetitions: int


def read_comparisons(path: Path) -> list[Comparison]:
    """Read a CSV table with the columns frequency_hz, reference_m_s2, sensor_m_s2.

    Raises:
        RigError: the file cannot be read, or names the line that holds no such numbers.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            return list(_rows(csv.DictReader(file), path))
    except (OSError, UnicodeDecodeError) as error:
        raise RigError(f"cannot read {path}: {error}") from error


def sensitivities(comparisons: Sequence[Comparison]) -> list[Sensitivity]:
    """Return the sensitivity at each frequency, in order of frequency.

    Raises:
        RigError: nothing to compare.
    """
    if not comparisons:
        raise RigError("no reading beside the reference; expected one or more a frequency")
    ratios: dict[float, list[float]] = defaultdict(list)
    for item in comparisons:
        ratios[item.frequency_hz].append(item.sensor_m_s2 / item.reference_m_s2)
    return [_sensitivity(frequency, ratios[frequency]) for frequency in sorted(ratios)]


def _sensitivity(frequency_hz: float, ratios: list[float]) -> Sensitivity:
    n = len(ratios)
    half = math.inf
    if n > 1:
        half = float(stats.t.ppf(0.975, n - 1) * np.std(ratios, ddof=1) / math.sqrt(n))
    return Sensitivity(frequency_hz, float(np.mean(ratios)), half, n)


def _rows(reader: csv.DictReader[str], path: Path) -> Iterable[Comparison]:
    if reader.fieldnames is None or not set(_COLUMNS) <= set(reader.fieldnames):
        raise RigError(
            f"{path} has the columns {reader.fieldnames}; expected {', '.join(_COLUMNS)}"
        )
    for row in reader:
        try:
            found = Comparison(*(float(row[name]) for name in _COLUMNS))
        except (TypeError, ValueError):
            found = Comparison(math.nan, math.nan, math.nan)
        numbers = (found.frequency_hz, found.reference_m_s2, found.sensor_m_s2)
        if not all(0.0 < number < math.inf for number in numbers):
            raise RigError(
                f"{path}:{reader.line_num}: found {[row[name] for name in _COLUMNS]}; expected "
                f"three numbers above 0: {', '.join(_COLUMNS)}"
            )
        yield found
