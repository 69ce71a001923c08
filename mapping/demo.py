"""A run from the devices to a judged map, in one folder: what a newcomer sees first."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from acquisition.files import replacing
from acquisition.messages.frames import StaticTransform
from acquisition.recording.plan import RecordingPlan
from acquisition.recording.source_worker import WorkerSettings
from acquisition.stream.reader import StreamMessage
from drivers.source import Source
from mapping.errors import MappingError
from mapping.files import make_folder
from mapping.judging.evaluation import Scores
from mapping.judging.origin import Origin
from mapping.judging.truth import Truth, evaluate_truth, read_truth
from mapping.live import record_and_map
from mapping.output.figures import write_figures
from mapping.output.map_file import write_map
from mapping.output.map_summary import RunSummary, summarise_run
from mapping.output.report import write_report
from mapping.session import MapOptions, MapResult
from mapping.settings import MapSettings

# A simulated rover drives while its source opens, and may take its time for it.
_LONGEST_DRIVE_S = 3600.0
# It then reports faster than real time; nothing may be dropped meanwhile.
_QUEUE_BYTES = 1 << 28


@dataclass(frozen=True, slots=True)
class Demo:
    """What is driven.

    Attributes:
        source: gives everything that the rover's devices report.
        write_truth: writes the truth of what was driven to a file, as `read_truth` reads it.
        static_transforms: where the devices sit.
        settings: goes into the recording, with the depth noise among it.
    """

    source: Source
    write_truth: Callable[[Path], None]
    static_transforms: Sequence[StaticTransform]
    settings: Mapping[str, object]


@dataclass(frozen=True, slots=True)
class DemoResult:
    """What the run left in its folder, and how good the map is."""

    folder: Path
    run: RunSummary
    scores: Scores
    seconds: float

    def as_json(self) -> dict[str, object]:
        """Return the scores under the names of `terravibe evaluate`, and the run."""
        return {
            **self.scores.as_json(),
            "origin": Origin("world").as_json(),
            "seconds": self.seconds,
            "run": self.run.as_json(),
        }

    def describe(self) -> list[str]:
        """Return the result as lines for people."""
        accuracy = (
            f"RMSE {1000 * self.scores.rmse_m:.2f} mm, P99 {1000 * self.scores.p99_m:.1f} mm; "
            f"{self.scores.completeness:.1%} of the visible cells"
        )
        honesty = (
            "within 1 sigma "
            f"{self.scores.coverage_1sigma:.1%} (aim 60-80 %), within 3 sigma "
            f"{self.scores.coverage_3sigma:.2%} (aim 98.5 % or more)"
        )
        done = f"{self.seconds:.1f} s; open {self.folder / 'report.html'}"
        return [*self.run.describe(), *self.scores.describe(), accuracy, honesty, done]


def run(
    demo: Demo,
    folder: Path,
    tell: Callable[[str], None] = lambda _: None,
    progress: Callable[[StreamMessage], None] = lambda _: None,
) -> DemoResult:
    """Record, map live, judge, draw and report into a folder.

    Leaves run.mcap, map.nc, truth.nc, metrics.json, report.html and the figures, in place of
    those of an earlier run.

    Args:
        demo: what is driven.
        folder: made where it is missing.
        tell: gets a line before each step.
        progress: gets each message that is mapped.

    Raises:
        MappingError: the folder cannot be made, or there is no map.
        DriverError, RecorderError, StreamError: the source or the recording failed.
    """
    recording = folder / "run.mcap"
    make_folder(folder)
    try:
        recording.unlink(missing_ok=True)
    except OSError as error:
        raise MappingError(
            f"cannot begin anew in {folder}: {error.strerror}; give a folder that can be written"
        ) from error
    start = time.monotonic()
    tell(f"driving; then all devices go to {recording}, which is mapped while it grows")
    plan = RecordingPlan(
        static_transforms=demo.static_transforms,
        settings=demo.settings,
        preflight_timeout_s=_LONGEST_DRIVE_S,
        worker=WorkerSettings(queue_limit_bytes=_QUEUE_BYTES),
    )
    mapped = record_and_map(demo.source, recording, plan, MapOptions(MapSettings()), progress)
    tell("comparing the map with the true terrain")
    demo.write_truth(folder / "truth.nc")
    truth = read_truth(folder / "truth.nc")
    scores = evaluate_truth(mapped.map, truth)
    summary = summarise_run(mapped, str(folder / "map.nc"))
    write_map(mapped.map, folder / "map.nc")
    tell("drawing the figures and the report")
    _report(folder, mapped, truth, scores, summary)
    result = DemoResult(folder, summary, scores, time.monotonic() - start)
    with replacing(folder / "metrics.json") as temporary:
        temporary.write_text(json.dumps(result.as_json(), indent=2, allow_nan=False) + "\n")
    return result


def _report(
    folder: Path, mapped: MapResult, truth: Truth, scores: Scores, summary: RunSummary
) -> None:
    """Draw the figures and write the report around them."""
    heights_m = truth.truth_at(mapped.map).height_m
    figures = write_figures(mapped.map, folder / "figures", heights_m, scores)
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
