"""A run from a device to a judged map, in one folder: what a newcomer sees first."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from acquisition.files import replacing
from acquisition.messages.frames import camera_is_tracked_body
from acquisition.stream.reader import StreamMessage
from drivers.source import Source
from mapping.errors import MappingError
from mapping.judging.evaluation import Scores
from mapping.judging.truth import Truth, evaluate_truth, write_truth
from mapping.live import record_and_map
from mapping.output.figures import write_figures
from mapping.output.map_file import write_map
from mapping.output.map_summary import RunSummary, summarise_run
from mapping.output.report import write_report
from mapping.session import MapOptions, MapResult
from mapping.settings import MapSettings


class KnownTerrain(Protocol):
    """Gives the true terrain after a drive, as a simulator knows it."""

    def __call__(self, cell_size_m: float, range_min_m: float, range_max_m: float) -> Truth:
        """Return the truth on cells of that size, with what could be seen within the range."""


@dataclass(frozen=True, slots=True)
class Demo:
    """What is driven.

    Attributes:
        source: gives poses of the depth camera, and depth.
        truth: the terrain that it drove over.
        depth_noise: its noise model, in the keys of a depth noise file.
    """

    source: Source
    truth: KnownTerrain
    depth_noise: Mapping[str, object]


@dataclass(frozen=True, slots=True)
class DemoResult:
    """What the run left in its folder, and how good the map is."""

    folder: Path
    run: RunSummary
    scores: Scores
    seconds: float

    def as_json(self) -> dict[str, object]:
        """Return the scores under the names of `terravibe evaluate`, and the run."""
        return {**self.scores.as_json(), "seconds": self.seconds, "run": self.run.as_json()}

    def describe(self) -> list[str]:
        """Return the result as lines for people."""
        verdict = (
            f"RMSE {1000 * self.scores.rmse_m:.2f} mm; within 1 sigma "
            f"{self.scores.coverage_1sigma:.1%} (aim 60-80 %), within 3 sigma "
            f"{self.scores.coverage_3sigma:.2%} (aim 98.5 % or more)"
        )
        done = f"{self.seconds:.1f} s; open {self.folder / 'report.html'}"
        return [*self.run.describe(), *self.scores.lines(), verdict, done]


def run(
    demo: Demo, folder: Path, progress: Callable[[StreamMessage], None] = lambda _: None
) -> DemoResult:
    """Record, map live, judge, draw and report into a folder.

    Leaves run.mcap, map.nc, truth.nc, metrics.json, report.html and the figures.

    Raises:
        MappingError: the folder cannot be made, or there is no map.
        DriverError, StreamError: the source or the recording failed.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise MappingError(f"cannot make the folder {folder}: {error.strerror}") from error
    start = time.monotonic()
    settings = MapSettings()
    mapped = record_and_map(
        demo.source,
        folder / "run.mcap",
        static_transforms=[camera_is_tracked_body()],
        settings={"depth_noise": demo.depth_noise},
        options=MapOptions(settings),
        progress=progress,
    )
    truth = demo.truth(settings.resolution_m, mapped.noise.range_min_m, mapped.noise.range_max_m)
    scores = evaluate_truth(mapped.map, truth)
    summary = summarise_run(mapped, str(folder / "map.nc"))
    write_map(mapped.map, folder / "map.nc")
    write_truth(folder / "truth.nc", truth)
    _report(folder, mapped, truth, scores, summary)
    result = DemoResult(folder, summary, scores, time.monotonic() - start)
    with replacing(folder / "metrics.json") as temporary:
        temporary.write_text(json.dumps(result.as_json(), indent=2, allow_nan=False) + "\n")
    return result


def _report(
    folder: Path, mapped: MapResult, truth: Truth, scores: Scores, summary: RunSummary
) -> None:
    """Draw the figures and write the report around them."""
    figures = write_figures(mapped.map, folder / "figures", truth.truth_at(mapped.map).height_m)
    facts = {name.replace("_", " "): str(value) for name, value in summary.counts.items()}
    for number, warning in enumerate(summary.warnings, 1):
        facts[f"warning {number}"] = warning
    write_report(
        folder / "report.html",
        "terravibe demo: a simulated drive, mapped while it was recorded",
        mapped.map,
        figures,
        scores,
        facts,
    )
