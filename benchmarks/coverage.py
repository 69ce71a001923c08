"""Accuracy and honesty of maps of simulated drives, pooled over seeds.

    python benchmarks/coverage.py [--scenarios NAME...] [--seeds N...] [--seconds S] [--json FILE]

Each run goes the way of a user's: `terravibe simulate`, `map --resolution 0.04`, `evaluate`, about
13 s of CPU time. Pooled numbers are those of all cells of all seeds together; of the quantiles,
which do not pool, the least and the largest of a seed are shown. The seeds 210 to 212 were never
looked at while the variance was made.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])

import argparse
import io
import json
import math
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import asdict, dataclass
from typing import Any

import cli

_SCENARIOS = ("simulation", "smooth", "rough", "outdoor")
_SEEDS = (210, 211, 212)
_SHARES = ("coverage_1sigma", "coverage_2sigma", "coverage_3sigma")
Scores = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Pooled:
    """Numbers of one set of cells over all seeds; (least, largest) of a seed where so named."""

    scenario: str
    part: str
    cells: int
    rmse_mm: float
    p99_mm: tuple[float, float]
    coverage: tuple[float, float, float]
    coverage_3sigma_of_seeds: tuple[float, float]
    anees: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenarios", nargs="+", default=_SCENARIOS, metavar="NAME")
    parser.add_argument("--seeds", nargs="+", type=int, default=_SEEDS, metavar="N")
    parser.add_argument("--seconds", type=float, default=20.0, metavar="S")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    rows = []
    print(
        f"{'scenario':11} {'cells':24} {'number':>8} {'RMSE':>6} {'P99 of seeds':>13} "
        f"{'1 sig':>6} {'2 sig':>6} {'3 sig':>6} {'3 sig of seeds':>14} {'ANEES':>6}"
    )
    for scenario in options.scenarios:
        runs = [scores_of(scenario, seed, options.seconds) for seed in options.seeds]
        for row in pooled(scenario, runs):
            _print(row)
            rows.append(row)
        complete = [100.0 * run["completeness"] for run in runs]
        print(f"{scenario:11} completeness {min(complete):.1f} to {max(complete):.1f} %")
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=2) + "\n")


def scores_of(scenario: str, seed: int, seconds: float) -> Scores:
    """Return what `terravibe evaluate --json` says of one run."""
    with tempfile.TemporaryDirectory() as folder:
        run, truth, map_file = (f"{folder}/{name}" for name in ("run.mcap", "truth.nc", "map.nc"))
        drive = ["--seed", str(seed), "--seconds", str(seconds)]
        _call("simulate", scenario, "-o", run, "--truth", truth, *drive)
        _call("map", run, "-o", map_file, "--resolution", "0.04")
        scores: Scores = json.loads(_call("evaluate", map_file, "--truth", truth, "--json"))
        return scores


def _call(*words: str) -> str:
    output = io.StringIO()
    with redirect_stdout(output):
        code = cli.main(words)
    if code != 0:
        sys.exit(f"terravibe {' '.join(words)}: exit code {code}")
    return output.getvalue()


def pooled(scenario: str, runs: Sequence[Scores]) -> list[Pooled]:
    """Return the sets of cells of all runs together."""
    parts: dict[str, list[Scores]] = {"all": list(runs)}
    for kind in ("slope", "range"):
        for name in runs[0][f"by_{kind}"]:
            parts[f"{kind} {name}"] = [run[f"by_{kind}"][name] for run in runs]
    for name in runs[0]["relative"]:
        label = f"from the rover {name.replace('_', ' ')}"
        parts[label] = [run["relative"][name] for run in runs]
    return [_pool(scenario, name, part) for name, part in parts.items()]


def _pool(scenario: str, name: str, runs: Sequence[Scores]) -> Pooled:
    filled = [run for run in runs if run["cells"]]
    cells = sum(run["cells"] for run in filled)

    def mean(key: str, power: int = 1) -> float:
        """Return the mean of a score to a power, by cells."""
        return (
            sum(run["cells"] * run[key] ** power for run in filled) / cells if cells else math.nan
        )

    def extremes(key: str, factor: float) -> tuple[float, float]:
        """Return the least and the largest of a score over the runs."""
        values = [factor * run[key] for run in filled] or [math.nan]
        return min(values), max(values)

    one, two, three = (mean(share) for share in _SHARES)
    return Pooled(
        scenario,
        name,
        cells,
        1000.0 * math.sqrt(mean("rmse_m", 2)),
        extremes("p99_m", 1000.0),
        (one, two, three),
        extremes("coverage_3sigma", 1.0),
        mean("anees"),
    )


def _print(row: Pooled) -> None:
    shares = " ".join(f"{100 * share:6.1f}" for share in row.coverage)
    low, high = row.coverage_3sigma_of_seeds
    print(
        f"{row.scenario:11} {row.part:24} {row.cells:8} {row.rmse_mm:6.2f} "
        f"{row.p99_mm[0]:6.1f}-{row.p99_mm[1]:<6.1f} {shares} "
        f"{100 * low:7.1f}-{100 * high:<6.1f} {row.anees:6.2f}"
    )


if __name__ == "__main__":
    main()
