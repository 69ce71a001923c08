"""`terravibe calibrate plate`: arguments in, one calibration or one session, words out.

Nothing heavy is imported before the command runs.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING

from acquisition.commands.console import CHECK_FAILED, OK, Console, prepare_depth_code, show

if TYPE_CHECKING:
    from calibration_rigs.plate_rig.manifest import Manifest

_WORKERS_AT_MOST = 2


def add_plate_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe calibrate plate`."""
    add = parser.add_argument
    add("cells", type=Path, nargs="?", metavar="CELLS", help="plate.toml, plate.csv or its folder")
    add("--session", type=Path, metavar="DIR", help="record the cells, guided; goes on in DIR")
    add("--config", type=Path, default=Path("rover.toml"), metavar="FILE", help="with --session")
    add("--seed", type=int, default=1, metavar="N", help="of the session's random order (1)")
    add("--environment", choices=("indoor", "outdoor"), default="indoor", help="with --session")
    add(
        "-o",
        "--output",
        type=Path,
        metavar="DIR",
        help="for file, report and tables (that of CELLS)",
    )
    add("--undistortion", action="store_true", help="also write the per-pixel map (.npz)")
    add("--workers", type=int, metavar="N", help="processes at work (2)")
    add("--json", action="store_true", help="print the verdict as JSON")


def run_plate(options: argparse.Namespace, console: Console) -> int:
    """Record a session, or turn recordings into a calibration; 1 when cells are not usable."""
    from calibration_rigs.errors import RigError
    from calibration_rigs.plate_rig.manifest import read_manifest

    if (options.cells is None) == (options.session is None):
        raise RigError("give either the recordings' plate.toml, or --session DIR to record them")
    if options.session is not None:
        return _session(options, console)
    return _process(options, read_manifest(options.cells), console)


def _process(options: argparse.Namespace, manifest: Manifest, console: Console) -> int:
    from calibration_rigs.plate_rig.process import process
    from calibration_rigs.plate_rig.report import Summary, check_products, write_products

    folder = options.output or manifest.folder
    check_products(folder)
    workers = options.workers or min(_WORKERS_AT_MOST, os.cpu_count() or 1)
    prepare_depth_code(console)  # here, not in every process at work
    with console.progress(f"calibrating on {len(manifest.cells)} cells") as reached:
        result = process(manifest, reached, workers)
        reached("drawing")
        files = write_products(result, folder, undistortion=options.undistortion)
    summary = Summary(result, tuple(files))
    show(console, summary, as_json=options.json)
    for warning in summary.warnings():
        console.note(f"warning: {warning}")
    return CHECK_FAILED if len(result.used) < len(manifest.cells) else OK


def _session(options: argparse.Namespace, console: Console) -> int:
    from calibration_rigs.plate_rig.manifest import read_rig
    from calibration_rigs.plate_rig.recording import RoverCapture
    from calibration_rigs.plate_rig.session import PlateSession, SessionPlan

    rig = read_rig(options.session)
    plan = SessionPlan(seed=options.seed, environment=options.environment, rig=rig)
    session = PlateSession(options.session, plan, RoverCapture(options.config), Keyboard(console))
    try:
        finished = session.run()
    except KeyboardInterrupt:  # what was recorded is kept; say so instead of "no output"
        finished = False
    console.lines([session.progress_line()])
    return OK if finished else CHECK_FAILED


class Keyboard:
    """Asks on standard input; see `calibration_rigs.plate_rig.questions.Operator`."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def say(self, text: str) -> None:
        """Tell the operator something."""
        self._console.lines([text])

    def ask(self, question: str) -> str:
        """Return what the operator types; an end of input counts as "quit"."""
        self._console.lines([question])
        try:
            return input("> ").strip()
        except EOFError:
            return "quit"

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        import time

        time.sleep(seconds)
