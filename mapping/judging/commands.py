"""The command that judges maps and trajectories: arguments in, one function called, words out.

Nothing heavy is imported before the command runs.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from acquisition.commands.console import OK, Console
from mapping.odometry_commands import add_comparison_arguments

if TYPE_CHECKING:
    from mapping.cells.elevation_map import ElevationMap
    from mapping.judging.evaluation import Scores
    from mapping.judging.floor_evaluation import FloorScores


def add_evaluate_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `terravibe evaluate`."""
    parser.add_argument(
        "subject", nargs="+", metavar="MAP | odometry EST TRUTH", help="a map, or two trajectories"
    )
    judge = parser.add_mutually_exclusive_group()
    judge.add_argument("--truth", type=Path, metavar="FILE.nc", help="true heights")
    judge.add_argument("--floor-height-m", type=float, metavar="M", help="height of a flat floor")
    parser.add_argument("--box", type=Path, metavar="FILE", help="a box that stands on the floor")
    parser.add_argument(
        "--trajectory",
        type=Path,
        metavar="FILE.txt",
        help="with --truth: the poses that the map was made with, where they are not the true ones",
    )
    parser.add_argument("--figures", type=Path, metavar="DIR", help="draw into DIR")
    parser.add_argument("--json", action="store_true", help="print the scores as JSON")
    add_comparison_arguments(parser)


def run_evaluate(options: argparse.Namespace, console: Console) -> int:
    """Compare a map with the truth or with a flat floor, or two trajectories."""
    from mapping.errors import MappingError
    from mapping.judging.floor_evaluation import evaluate_floor, read_box
    from mapping.odometry_commands import compare_trajectories
    from mapping.output.map_file import read_map

    if options.subject[0] == "odometry":
        return compare_trajectories(options, console)
    if options.align is not None:
        raise MappingError("--align is for evaluate odometry; a map is judged where it lies")
    if len(options.subject) != 1 or (options.truth is None and options.floor_height_m is None):
        raise MappingError(
            "give one map with --truth FILE.nc or --floor-height-m M, or odometry EST TRUTH"
        )
    map_ = read_map(Path(options.subject[0]))
    scores: Scores | FloorScores
    if options.truth and options.box:
        raise MappingError("--box is for --floor-height-m; a truth knows its boxes")
    if options.truth:
        scores = _evaluate_truth(map_, options, console)
    elif options.trajectory or options.figures:
        raise MappingError("--trajectory and --figures need --truth; a flat floor has neither")
    else:
        box = read_box(options.box) if options.box else None
        scores = evaluate_floor(map_, options.floor_height_m, box)
    if options.json:
        console.json(scores.as_json())
    else:
        console.lines(scores.lines())
    return OK


def _evaluate_truth(map_: ElevationMap, options: argparse.Namespace, console: Console) -> Scores:
    from drivers.depth.trajectory import read_trajectory
    from mapping.judging.truth import evaluate_truth, read_truth
    from mapping.output.figures import write_figures

    truth = read_truth(options.truth)
    believed = read_trajectory(options.trajectory) if options.trajectory else None
    pose_source = map_.attributes.get("setting_pose_source", "mocap")
    if believed is None and pose_source != "mocap":
        console.note(
            f"warning: the map's poses are those of {pose_source}, and count as true here: what is "
            "off in the world is so for the rover too; give them with --trajectory"
        )
    scores = evaluate_truth(map_, truth, believed=believed)
    if options.figures:
        with console.progress(f"drawing into {options.figures}"):
            write_figures(map_, options.figures, truth.truth_at(map_).height_m, scores)
    return scores
